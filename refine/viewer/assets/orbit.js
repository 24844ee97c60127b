// The camera that all panels share, and the hands on it: mouse, touch, wheel.

const LENS = (26 * Math.PI) / 180;
const HOME = { yaw: 0.5, elevation: 0.16, zoom: 1, pan: [0, 0, 0] };

class Orbit {
  constructor(canvas, changed) {
    this.changed = changed;
    this.fingers = new Map();
    this.reset();
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button > 2) return;
      canvas.setPointerCapture(event.pointerId);
      this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => this.dragged(event, canvas));
    for (const name of ["pointerup", "pointercancel"])
      canvas.addEventListener(name, (event) => this.fingers.delete(event.pointerId));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    // The wheel scrolls the page until the stage was chosen; pinching a touchpad comes as a wheel with ctrl.
    canvas.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey && document.activeElement !== canvas) return;
        event.preventDefault();
        this.magnify(Math.exp(clamp(event.deltaY, -60, 60) * (event.ctrlKey ? -0.012 : -0.004)));
      },
      { passive: false },
    );
  }

  reset() {
    Object.assign(this, HOME, { pan: [0, 0, 0] });
    this.changed();
  }

  dragged(event, canvas) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [across, down] = [now[0] - before[0], now[1] - before[1]];
    if (this.fingers.size === 2) {
      const other = [...this.fingers].find(([id]) => id !== event.pointerId)[1];
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
      this.magnify(apart(now) / apart(before));
      this.slide(across / 2, down / 2, canvas);
    } else if (event.shiftKey || event.buttons === 2 || event.buttons === 4) this.slide(across, down, canvas);
    else this.turn(-across * 0.008, down * 0.006);
    this.fingers.set(event.pointerId, now);
  }

  turn(yaw, elevation) {
    this.yaw += yaw;
    this.elevation = clamp(this.elevation + elevation, -0.04, 1.5);
    this.changed();
  }

  magnify(factor) {
    this.zoom = clamp(this.zoom * factor, 0.25, 6);
    this.changed();
  }

  // Move what is looked at along the picture, by pixels of the page.
  slide(across, down, canvas) {
    const metres = (2.2 / this.zoom / canvas.clientHeight) * 1.2;
    const right = [Math.cos(this.yaw), 0, -Math.sin(this.yaw)];
    const moved = add(this.pan, add(scaled(right, -across * metres), [0, down * metres, 0]));
    this.pan = moved.map((value) => clamp(value, -20, 20));
    this.changed();
  }

  // Where the eye is and what it sees, so that everything within `extent` of `centre` fits.
  view(centre, { top, aside }, aspect) {
    const tangent = Math.tan(LENS / 2);
    const half = Math.max(0.56 * top, aside / aspect);
    const distance = (half / tangent + aside * 0.3) / this.zoom;
    const height = Math.min(half - 0.08 * top, 0.6 * top); // room that is left over goes above, where the names are
    const target = add(add(centre, [0, height, 0]), this.pan);
    const level = Math.cos(this.elevation);
    const way = [Math.sin(this.yaw) * level, Math.sin(this.elevation), Math.cos(this.yaw) * level];
    const eye = add(target, scaled(way, distance));
    eye[1] = Math.max(eye[1], 0.03);
    return { eye, camera: product(perspective(LENS, aspect, 0.05, 80), looking(eye, target)) };
  }
}
