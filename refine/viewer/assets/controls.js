// Names on the stage, buttons, and keys.

const $ = (id) => document.getElementById(id);
const RATES = [0.1, 0.25, 0.5, 1, 1.5, 2];
const TURN = 0.12; // radians a key press
const NEARER = 1.12; // times

class Controls {
  constructor(viewer) {
    this.viewer = viewer;
    this.timing();
    this.viewing();
    document.addEventListener("keydown", (event) => this.pressed(event));
  }

  timing() {
    const { viewer } = this;
    const scrubber = $("scrubber");
    Object.assign(scrubber, { max: viewer.duration, step: "any" });
    scrubber.addEventListener("input", () => {
      viewer.play(false);
      viewer.seek(Number(scrubber.value));
    });
    $("play").addEventListener("click", () => viewer.play());
    $("back").addEventListener("click", () => viewer.stepBy(-1));
    $("on").addEventListener("click", () => viewer.stepBy(1));
    const rate = $("rate");
    rate.append(...RATES.map((value) => element("option", { value, selected: value === 1 }, `${value}×`)));
    rate.addEventListener("change", () => (viewer.rate = Number(rate.value)));
    this.toggle("loop", "looping");
  }

  viewing() {
    const { viewer } = this;
    this.toggle("bones", "bones");
    this.toggle("follow", "following");
    this.toggle("cameras", "cameras");
    this.toggle("overlay", "overlaid");
    $("overlay").hidden = viewer.clips.length < 2;
    $("cameras").hidden = !viewer.looking;
    $("reset").addEventListener("click", () => viewer.orbit.reset());
    this.paints = [...document.querySelectorAll("input[name=colours]")];
    for (const paint of this.paints) {
      paint.addEventListener("change", () => {
        viewer.colours = paint.value;
        viewer.changed();
      });
    }
    $("help-open").addEventListener("click", () => $("help").showModal());
    $("theme").addEventListener("click", () => {
      document.documentElement.dataset.theme = viewer.dark ? "light" : "dark";
      viewer.retheme();
    });
  }

  // A button that switches one of the viewer's properties.
  toggle(id, property) {
    const { viewer } = this;
    const button = $(id);
    const show = () => button.setAttribute("aria-pressed", viewer[property]);
    button.addEventListener("click", () => {
      viewer[property] = !viewer[property];
      show();
      viewer.changed();
    });
    show();
  }

  hasten(by) {
    const rate = $("rate");
    rate.selectedIndex = clamp(rate.selectedIndex + by, 0, RATES.length - 1);
    this.viewer.rate = Number(rate.value);
    this.viewer.say(`${rate.value} times`);
  }

  pressed(event) {
    const on = document.activeElement;
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if ($("help").open) {
      if ("h?".includes(event.key)) $("help").close();
      return;
    }
    // What was reached by keys keeps the keys that work it; what was clicked leaves them to the player.
    const keeps = { select: /./, "button, summary, a[href]": /^( |Enter)$/, "input[type=radio]": /^( |Arrow.*)$/ };
    for (const [kind, keys] of Object.entries(keeps)) {
      const reached = kind === "select" || on?.matches(":focus-visible");
      if (reached && on?.matches(kind) && keys.test(event.key)) return;
    }
    const act = this.meaning(event, on === this.viewer.canvas);
    if (!act) return;
    event.preventDefault();
    act();
  }

  // What a key does; with shift or up and down only where the stage was chosen, since the page has its own use of these.
  meaning({ key, shiftKey }, staged) {
    const { viewer } = this;
    const { orbit, canvas } = viewer;
    const click = (id) => () => $(id).hidden || $(id).click();
    if (/^\d$/.test(key)) return () => viewer.solo(Number(key) - 1);
    if (staged && shiftKey && /^Arrow/.test(key)) {
      const [yaw, elevation] = { Left: [-1, 0], Right: [1, 0], Up: [0, 0.8], Down: [0, -0.8] }[key.slice(5)];
      return () => orbit.turn(yaw * TURN, elevation * TURN);
    }
    const onStage = { ArrowUp: () => orbit.magnify(NEARER), ArrowDown: () => orbit.magnify(1 / NEARER) };
    const timed = staged || document.activeElement === $("scrubber");
    const onTime = { Home: () => viewer.seek(0), End: () => viewer.seek(viewer.duration) };
    const anywhere = {
      " ": () => viewer.play(),
      k: () => viewer.play(),
      ArrowLeft: () => viewer.stepBy(shiftKey ? -10 : -1),
      ArrowRight: () => viewer.stepBy(shiftKey ? 10 : 1),
      ",": () => this.hasten(-1),
      ".": () => this.hasten(1),
      "[": () => orbit.turn(-TURN, 0),
      "]": () => orbit.turn(TURN, 0),
      "+": () => orbit.magnify(NEARER),
      "=": () => orbit.magnify(NEARER),
      "-": () => orbit.magnify(1 / NEARER),
      w: () => orbit.slide(0, 24, canvas),
      a: () => orbit.slide(24, 0, canvas),
      s: () => orbit.slide(0, -24, canvas),
      d: () => orbit.slide(-24, 0, canvas),
      c: () => this.paints[(this.paints.findIndex((paint) => paint.checked) + 1) % this.paints.length].click(),
      l: click("loop"),
      b: click("bones"),
      f: click("follow"),
      o: click("overlay"),
      v: click("cameras"),
      r: click("reset"),
      t: click("theme"),
      h: click("help-open"),
      "?": click("help-open"),
    };
    return { ...anywhere, ...(staged ? onStage : {}), ...(timed ? onTime : {}) }[key];
  }
}

// The motions' names and numbers over their panels; a click shows one alone.
function namePanels(viewer, panels) {
  const buttons = panels.flatMap(({ clips, left, top, width }) =>
    clips.map((clip, k) => {
      const [pressed, title] = [
        viewer.only === clip.index,
        viewer.only < 0 ? "Show only this motion" : "Show all motions",
      ];
      const button = element("button", { type: "button", "aria-pressed": pressed, title });
      if (viewer.clips.length > 1) button.append(element("kbd", {}, clip.index + 1));
      button.append(element("span", {}, clip.name));
      if (clip.role && clip.label) button.append(element("small", {}, clip.role));
      if (viewer.overlaid) button.style.setProperty("--dot", EACH[clip.index % EACH.length]);
      button.style.left = `${100 * left}%`;
      button.style.maxWidth = `calc(${100 * width}% - 1.4rem)`;
      button.style.top = `calc(${100 * top}% + ${2.4 * k}rem)`;
      button.addEventListener("click", () => viewer.solo(clip.index));
      return button;
    }),
  );
  const seams = panels.map(({ left, top, width, height }) => {
    const seam = element("i", { class: "seam", "data-aside": String(left > 0), "data-under": String(top > 0) });
    const shares = { left, top, width, height };
    for (const [side, share] of Object.entries(shares)) seam.style[side] = `${100 * share}%`;
    return seam;
  });
  $("names").replaceChildren(...buttons, ...seams);
}
