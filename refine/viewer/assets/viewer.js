// The page: what is shown, and when.

const NARROW = 620; // pixels of the stage below which four motions stand two by two
const CAMERAS = { top: 2.1, aside: 1.1 }; // metres that the loop's cameras want
const LOWEST = 330; // pixels of the stage's height

class Viewer {
  constructor(data) {
    const array = unpacker(data.bytes);
    this.skeleton = new Skeleton(data.body, array);
    this.clips = data.motions.map((entry, index) => new Clip(entry, array, this.skeleton, index));
    this.looking = data.looking;
    for (const made of this.looking?.made ?? []) {
      made.corners = array(made.corners);
      made.loss = made.loss.map(array);
    }
    this.seconds = 0;
    this.duration = Math.max(...this.clips.map((clip) => clip.seconds));
    this.longest = this.clips.find((clip) => clip.seconds === this.duration);
    this.greatest = Math.max(0.3, ...this.clips.map((clip) => greatestOf(clip.speeds)));
    Object.assign(this, { playing: false, looping: true, rate: 1, last: 0 });
    Object.assign(this, { only: -1, overlaid: false, following: true, colours: "parts", bones: false, cameras: false });
    this.canvas = $("canvas");
    this.renderer = new Renderer(this.canvas, data.body, array);
    this.renderer.arrived = () => this.changed();
    this.orbit = new Orbit(this.canvas, () => this.changed());
    this.measure();
    this.cards(data);
    this.fit();
    this.controls = new Controls(this);
    this.watch();
    this.draw();
    requestAnimationFrame((now) => this.tick(now));
  }

  // Draw again, soon.
  changed() {
    this.stale = true;
  }

  say(text) {
    $("said").textContent = text;
  }

  // --- time

  // The motion whose frames are counted.
  get counted() {
    return this.clips[this.only] ?? this.longest;
  }

  get frame() {
    return clamp(Math.round(this.seconds * this.counted.fps), 0, this.counted.frames - 1);
  }

  seek(seconds) {
    this.seconds = clamp(seconds, 0, this.duration);
    this.changed();
  }

  stepBy(frames) {
    const { fps } = this.counted;
    this.play(false);
    this.seek((Math.round(this.seconds * fps) + frames) / fps);
    this.say(`frame ${this.frame + 1}`);
  }

  play(playing = !this.playing) {
    if (playing && this.seconds >= this.duration - 1e-9) this.seconds = 0;
    this.playing = playing && this.duration > 0;
    $("play").setAttribute("aria-label", this.playing ? "Pause" : "Play");
    $("play").dataset.playing = this.playing;
    this.changed();
  }

  tick(now) {
    const passed = Math.min(0.1, (now - this.last) / 1000);
    this.last = now;
    if (this.playing && this.visible) this.advance(passed * this.rate);
    if (this.stale && this.visible && !this.renderer.gl.isContextLost()) {
      this.stale = false;
      this.draw();
      this.tell(now);
    }
    requestAnimationFrame((next) => this.tick(next));
  }

  advance(seconds) {
    this.seconds += seconds;
    if (this.seconds >= this.duration) {
      if (this.looping) this.seconds %= this.duration;
      else {
        this.seconds = this.duration;
        this.play(false);
      }
    }
    this.changed();
  }

  tell(now) {
    const [at, whole] = [this.seconds.toFixed(2), this.duration.toFixed(2)];
    $("time").textContent = `${at} / ${whole} s`;
    $("frame").textContent = `frame ${this.frame + 1} of ${this.counted.frames}`;
    const scrubber = $("scrubber");
    scrubber.value = this.seconds;
    scrubber.style.setProperty("--done", `${(100 * this.seconds) / (this.duration || 1)}%`);
    scrubber.setAttribute("aria-valuetext", `${at} seconds, frame ${this.frame + 1}`);
    if (this.speeds.update(this.seconds, now)) this.changed(); // numbers follow more slowly than bars
    this.loop?.update(Math.round(this.seconds * this.clips[0].fps));
  }

  // --- space

  get shown() {
    return this.only < 0 ? this.clips : [this.clips[this.only]];
  }

  solo(index) {
    this.only = this.only === index || !this.clips[index] ? -1 : index;
    this.say(this.only < 0 ? "all motions" : `only ${this.clips[this.only].name}`);
    this.changed();
  }

  measure() {
    const moments = Array.from({ length: 33 }, (_, k) => (this.duration * k) / 32);
    const places = moments.map((seconds) => this.clips.map((clip) => clip.follow(seconds)));
    this.middle = middleOf(places.flat());
    const apart = (at) => Math.max(...at.map((place) => Math.hypot(...subtract(place, middleOf(at)))));
    this.spread = Math.max(...places.map(apart)); // of motions laid over one another
    this.extents = { true: extent(this.clips, true), false: extent(this.clips, false, this.middle) };
  }

  // What has to fit in a panel.
  get reach() {
    const { top, aside } = this.extents[this.following];
    if (this.overlaid && this.following && this.only < 0) return { top, aside: aside + this.spread };
    if (!this.cameras || !this.looking) return { top, aside };
    return { top: Math.max(top, CAMERAS.top), aside: Math.max(aside, CAMERAS.aside) };
  }

  // As high as panels side by side need, so that no room is lost above and below narrow ones.
  fit() {
    const { clientWidth } = this.canvas;
    const { top, aside } = this.extents.true;
    const narrow = clientWidth < NARROW;
    const rows = narrow && this.clips.length > 2 ? Math.ceil(this.clips.length / 2) : 1;
    const wanted = rows * (40 + (clientWidth * 1.12 * top) / (2 * aside * Math.ceil(this.clips.length / rows)));
    const most = Math.max(LOWEST, innerHeight * (narrow ? 0.6 : 0.64));
    const height = Math.round(clamp(wanted, LOWEST, most));
    if (height !== this.height) this.canvas.parentElement.style.height = `${height}px`;
    this.height = height;
  }

  // Panels with their left, top, width and height in shares of the stage: as many columns as make them largest.
  panels() {
    const groups = this.overlaid ? [this.shown] : this.shown.map((clip) => [clip]);
    const { clientWidth, clientHeight } = this.canvas;
    const { top, aside } = this.reach;
    const rowsOf = (columns) => Math.ceil(groups.length / columns);
    const size = (columns) => Math.min(clientWidth / columns / (2 * aside), clientHeight / rowsOf(columns) / top);
    let columns = 1;
    for (let more = 2; more <= groups.length; more++) if (size(more) > size(columns) * 1.02) columns = more;
    const rows = rowsOf(columns);
    return groups.map((clips, k) => {
      const row = Math.floor(k / columns);
      const across = Math.min(columns, groups.length - row * columns);
      return { clips, left: (k % columns) / across, top: row / rows, width: 1 / across, height: 1 / rows };
    });
  }

  draw() {
    const { canvas, renderer } = this;
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const scene = SCENES[this.dark ? "dark" : "light"];
    const panels = this.panels();
    this.name(panels);
    for (const panel of panels) {
      const [left, right] = [panel.left, panel.left + panel.width].map((share) => Math.round(share * width));
      const [top, bottom] = [panel.top, panel.top + panel.height].map((share) => Math.round(share * height));
      const box = [left, height - bottom, right - left, bottom - top];
      const followed = middleOf(panel.clips.map((clip) => clip.follow(this.seconds)));
      const centre = this.following ? followed : this.middle;
      const view = this.orbit.view(centre, this.reach, box[2] / box[3]);
      const actors = panel.clips.map((clip) => ({
        clip,
        ...clip.pose(this.seconds),
        tints: tintsOf(this, clip, scene),
      }));
      const marks = { under: [], among: [], over: [], pictures: [] };
      for (const actor of actors) annotate(this, actor, marks, scene, ratio);
      renderer.draw({ box, centre: followed, ...view, actors, ...marks, seeThrough: this.bones }, scene);
    }
  }

  // Names are made anew only when they change, so that they keep the focus.
  name(panels) {
    const now = JSON.stringify([this.only, this.overlaid, panels.map(({ left, top }) => [left, top])]);
    if (now !== this.named) namePanels(this, panels);
    this.named = now;
  }

  // --- the page around

  cards(data) {
    this.speeds = new SpeedsCard($("speeds"), this.clips, this.skeleton.partNames);
    numbersTable($("numbers").querySelector("table"), this.clips);
    if (this.looking) {
      $("loop-card").hidden = false;
      this.loop = new LoopCard($("loop-card"), this.looking, this.clips, () => this.changed());
      for (const frame of this.looking.moments) {
        const mark = element("i");
        mark.style.left = `${(100 * frame) / this.clips[0].fps / (this.duration || 1)}%`;
        $("marks").append(mark);
      }
    }
    if (data.history?.total?.length > 1) {
      $("loss").hidden = false;
      new LossCard($("loss"), data.history);
    }
  }

  retheme() {
    const [red, green, blue] = getComputedStyle(document.body)
      .backgroundColor.match(/[\d.]+/g)
      .map(Number);
    this.dark = red + green + blue < 380;
    this.changed();
  }

  watch() {
    this.visible = true;
    new IntersectionObserver((seen) => {
      this.visible = seen.at(-1).isIntersecting;
      this.changed();
    }).observe(this.canvas);
    new ResizeObserver(() => {
      this.fit();
      this.changed();
    }).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.retheme());
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => location.reload());
    this.retheme();
  }
}

function middleOf(places) {
  return scaled(places.reduce(add), 1 / places.length);
}

function greatestOf(values) {
  return values.reduce((a, b) => Math.max(a, b), 0);
}

function start() {
  const data = JSON.parse($("data").textContent);
  const page = document.documentElement;
  let viewer;
  page.dataset.lively = "true"; // shown before it is measured
  try {
    viewer = new Viewer(data);
  } catch (error) {
    $("unable").textContent = `This browser cannot draw the moving bodies (${error.message}); below are poses instead.`;
    page.dataset.lively = "false";
    return;
  }
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) viewer.seek(viewer.duration / 2);
  else viewer.play(true);
  // For the curious at the console, and for tests.
  window.refine = {
    joints: (motion, seconds) => Array.from(viewer.clips[motion].pose(seconds).joints),
    seek: (seconds) => viewer.seek(seconds),
    play: (playing) => viewer.play(playing),
    get seconds() {
      return viewer.seconds;
    },
    get playing() {
      return viewer.playing;
    },
  };
}

start();
