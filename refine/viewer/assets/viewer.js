// The page: what is shown and when, the controls, the keys.

const $ = (id) => document.getElementById(id);
const RATES = [0.1, 0.25, 0.5, 1, 1.5, 2];
const PARTS = { torso: "#8d99ae", left_arm: "#e76f51", right_arm: "#2a9d8f", left_leg: "#f4a259", right_leg: "#4f7cac" };
const HEAD = "#e5c29f"; // of neck and head, which belong to the torso otherwise
const HEAT = ["#efe3cf", "#fcd28b", "#f58f5c", "#c8446b", "#5c2a72"];
const EACH = ["#d1495b", "#00798c", "#edae49", "#7b6fd0", "#66a182", "#5b7fa6"]; // of motions laid over one another
const BONE = [0.11, 0.13, 0.22];

const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);

function heat(share) {
  const at = clamp(share, 0, 1) * (HEAT.length - 1);
  const low = Math.min(Math.floor(at), HEAT.length - 2);
  return mixed(rgb(HEAT[low]), rgb(HEAT[low + 1]), at - low);
}

function middleOf(places) {
  return scaled(places.reduce(add), 1 / places.length);
}

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
    this.greatest = Math.max(0.3, ...this.clips.flatMap((clip) => [...clip.speeds]));
    Object.assign(this, { playing: false, looping: true, rate: 1, only: -1, overlaid: false, colours: "parts" });
    Object.assign(this, { following: true, bones: false, cameras: false, stale: true, last: 0 });
    this.canvas = $("canvas");
    this.renderer = new Renderer(this.canvas, data.body, array);
    this.renderer.arrived = () => this.changed();
    this.orbit = new Orbit(this.canvas, () => this.changed());
    this.measure();
    this.cards(data);
    this.fit();
    this.labels();
    this.controls();
    this.watch();
    requestAnimationFrame((now) => this.tick(now));
  }

  changed() {
    this.stale = true;
  }

  // --- time

  get step() {
    return 1 / this.clips[Math.max(0, this.only)].fps;
  }

  seek(seconds) {
    this.seconds = clamp(seconds, 0, this.duration);
    this.changed();
  }

  stepBy(frames) {
    this.play(false);
    const at = Math.round(this.seconds / this.step) + frames;
    this.seek(at * this.step);
    this.say(`frame ${this.frame + 1}`);
  }

  get frame() {
    const clip = this.clips[Math.max(0, this.only)];
    return clamp(Math.round(this.seconds * clip.fps), 0, clip.frames - 1);
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
    if (this.playing && this.visible) {
      this.seconds += passed * this.rate;
      if (this.seconds >= this.duration) {
        if (this.looping) this.seconds %= this.duration;
        else {
          this.seconds = this.duration;
          this.play(false);
        }
      }
      this.stale = true;
    }
    if (this.stale && this.visible && !this.renderer.gl.isContextLost()) {
      this.stale = false;
      this.draw();
      this.tell(now);
    }
    requestAnimationFrame((next) => this.tick(next));
  }

  tell(now) {
    const clip = this.clips[Math.max(0, this.only)];
    $("time").textContent = `${this.seconds.toFixed(2)} / ${this.duration.toFixed(2)} s`;
    $("frame").textContent = `frame ${this.frame + 1} of ${clip.frames}`;
    const scrubber = $("scrubber");
    scrubber.value = this.seconds;
    scrubber.style.setProperty("--done", `${(100 * this.seconds) / (this.duration || 1)}%`);
    scrubber.setAttribute("aria-valuetext", `${this.seconds.toFixed(2)} seconds, frame ${this.frame + 1}`);
    if (this.speeds.update(this.seconds, now)) this.stale = true; // numbers follow more slowly than bars
    this.loop?.update(Math.round(this.seconds * this.clips[0].fps));
  }

  say(text) {
    $("said").textContent = text;
  }

  // --- space

  get shown() {
    return this.only < 0 ? this.clips : [this.clips[this.only]];
  }

  measure() {
    const moments = Array.from({ length: 33 }, (_, k) => (this.duration * k) / 32);
    const places = moments.map((seconds) => this.clips.map((clip) => clip.follow(seconds)));
    this.middle = middleOf(places.flat());
    const apart = (at) => Math.max(...at.map((place) => Math.hypot(...subtract(place, middleOf(at)))));
    this.spread = Math.max(...places.map(apart)); // of motions laid over one another
    this.extents = { true: extent(this.clips, true), false: extent(this.clips, false, this.middle) };
  }

  // What has to fit in a panel; the loop's cameras want more room than the body.
  get reach() {
    const { top, aside: narrow } = this.extents[this.following];
    const aside = narrow + (this.overlaid && this.following && this.only < 0 ? this.spread : 0);
    return this.cameras && this.looking ? { top: Math.max(top, 2.1), aside: Math.max(aside, 1.1) } : { top, aside };
  }

  // As high as panels side by side need, so that no room is lost above and below narrow ones.
  fit() {
    const { clientWidth } = this.canvas;
    const { top, aside } = this.extents[true];
    const most = innerHeight * (clientWidth < 620 ? 0.6 : 0.64);
    const rows = clientWidth < 620 && this.clips.length > 2 ? Math.ceil(this.clips.length / 2) : 1;
    const wanted = rows * (40 + (clientWidth * 1.12 * top) / (2 * aside * Math.ceil(this.clips.length / rows)));
    const height = Math.round(clamp(wanted, Math.min(330, most), Math.max(most, 330)));
    if (height !== this.height) this.canvas.parentElement.style.height = `${height}px`;
    this.height = height;
  }

  // Panels with their left, top, width and height in shares of the stage: as many columns as make them largest.
  panels() {
    const groups = this.overlaid ? [this.shown] : this.shown.map((clip) => [clip]);
    const { clientWidth, clientHeight } = this.canvas;
    const { top, aside } = this.reach;
    const size = (columns) => Math.min(clientWidth / columns / (2 * aside), clientHeight / Math.ceil(groups.length / columns) / top);
    let columns = 1;
    for (let more = 2; more <= groups.length; more++) if (size(more) > size(columns) * 1.02) columns = more;
    const rows = Math.ceil(groups.length / columns);
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
    const places = JSON.stringify(panels.map(({ left, top, clips }) => [left, top, clips.length]));
    if (places !== this.places) this.labels();
    this.places = places;
    for (const panel of panels) {
      const [left, right] = [Math.round(panel.left * width), Math.round((panel.left + panel.width) * width)];
      const [top, bottom] = [Math.round(panel.top * height), Math.round((panel.top + panel.height) * height)];
      const box = [left, height - bottom, right - left, bottom - top];
      const centre = this.following ? middleOf(panel.clips.map((clip) => clip.follow(this.seconds))) : this.middle;
      const view = this.orbit.view(centre, this.reach, box[2] / box[3]);
      const actors = panel.clips.map((clip) => ({ clip, ...clip.pose(this.seconds), tints: this.tints(clip, scene) }));
      const lines = { under: [], among: [], over: [] };
      const pictures = [];
      for (const actor of actors) this.annotate(actor, lines, pictures, scene, ratio);
      renderer.draw({ box, centre, ...view, actors, lines, pictures, seeThrough: this.bones }, scene);
    }
  }

  // A colour for each joint; vertices mix those of the joints that they follow.
  tints(clip, scene) {
    const { partOf, partNames, count, names } = this.skeleton;
    const colours = new Float32Array(3 * count);
    const speeds = clip.speedsAt(this.seconds);
    for (let joint = 0; joint < count; joint++) {
      const part = Math.max(0, partOf[joint]); // the pelvis is in none and goes with the torso
      let colour = scene.plain;
      if (this.colours === "motion") colour = heat(Math.sqrt(speeds[part] / this.greatest));
      else if (this.colours === "parts" && !this.overlaid)
        colour = rgb(["neck", "head"].includes(names[joint]) ? HEAD : PARTS[partNames[part]]);
      else if (this.overlaid) colour = rgb(EACH[clip.index % EACH.length]);
      colours.set(colour, 3 * joint);
    }
    return colours;
  }

  annotate({ clip, joints }, lines, pictures, scene, ratio) {
    const ink = scene.ink;
    const every = Math.max(1, Math.round(clip.fps / 12));
    for (let frame = 0; frame + every < clip.frames; frame += every) {
      const at = (k) => [clip.path[3 * k], 0, clip.path[3 * k + 2]];
      const passed = frame / clip.fps <= this.seconds;
      lines.under.push([at(frame), at(frame + every), [...ink, passed ? 0.4 : 0.14], 2 * ratio]);
    }
    if (this.bones) {
      const at = (joint) => [...joints.subarray(3 * joint, 3 * joint + 3)];
      const light = this.dark ? [0.95, 0.95, 0.92] : BONE;
      this.skeleton.parents.forEach((up, joint) => {
        if (up >= 0) lines.over.push([at(up), at(joint), [...light, 0.85], 2.4 * ratio]);
      });
      this.skeleton.parents.forEach((_, joint) => {
        lines.over.push([at(joint), at(joint), [...light, 1], 7.5 * ratio]);
        lines.over.push([at(joint), at(joint), [...(this.dark ? BONE : [1, 1, 1]), 1], 4 * ratio]);
      });
    }
    const made = this.looking?.made.find(({ motion }) => motion === clip.index);
    if (this.cameras && made && !this.overlaid) this.stand(made, clip, lines, pictures, ink, ratio);
  }

  // The loop's cameras: by weak perspective they see along parallel lines, so that a box is what they see.
  stand(made, clip, lines, pictures, ink, ratio) {
    const frame = clamp(Math.round(this.seconds * clip.fps), 0, clip.frames - 1);
    for (let view = 0; view < made.views; view++) {
      const chosen = view === this.loop.view;
      const corner = (k) => [...made.corners.subarray(12 * (made.views * frame + view) + 3 * k, 12 * (made.views * frame + view) + 3 * k + 3)];
      const through = [0, 1, 2, 3].map(corner);
      const forward = normalised(cross(subtract(through[1], through[0]), subtract(through[3], through[0])));
      const half = Math.hypot(...subtract(through[1], through[0])) / 2;
      const lens = through.map((p) => add(p, scaled(forward, -0.9 * half)));
      const screen = through.map((p) => add(p, scaled(forward, 0.9 * half)));
      const colour = [...ink, chosen ? 0.5 : 0.16];
      for (let k = 0; k < 4; k++) {
        lines.among.push([screen[k], screen[(k + 1) % 4], colour, (chosen ? 1.6 : 1) * ratio]);
        lines.among.push([lens[k], screen[k], [...ink, chosen ? 0.22 : 0.1], ratio]);
      lines.among.push([lens[k], lens[(k + 1) % 4], [...ink, chosen ? 0.3 : 0.1], ratio]);
      }
      if (!chosen) continue;
      const { moments, stages } = this.looking;
      const window = [this.loop.nearest(frame) / moments.length, stages.indexOf("composition") / stages.length, 1 / moments.length, 1 / stages.length];
      pictures.push({ url: made.sheets[0][view], corners: screen, window, paper: rgb("#f7f5f0"), veil: this.dark ? 0.05 : 0.16 });
    }
  }

  // --- the page around

  cards(data) {
    this.speeds = new SpeedsCard($("speeds"), this.clips, this.skeleton.partNames);
    numbersTable($("numbers").querySelector("table"), this.clips);
    if (this.looking) {
      $("loop-card").hidden = false;
      this.loop = new LoopCard($("loop-card"), this.looking, this.clips, () => this.changed());
      const marks = this.looking.moments.map((frame) => {
        const mark = element("i");
        mark.style.left = `${(100 * frame) / this.clips[0].fps / (this.duration || 1)}%`;
        return mark;
      });
      $("marks").append(...marks);
    } else $("cameras").hidden = true;
    if (Object.keys(data.history ?? {}).length && data.history.total?.length > 1) {
      $("loss").hidden = false;
      new LossCard($("loss"), data.history);
    }
  }

  labels() {
    const names = $("names");
    const panels = this.panels();
    const buttons = panels.flatMap(({ clips, left, top }) => clips.map((clip, k) => {
      const button = element("button", { type: "button", "aria-pressed": this.only === clip.index, title: this.only < 0 ? "Show only this motion" : "Show all motions" });
      if (this.clips.length > 1) button.append(element("kbd", {}, clip.index + 1));
      button.append(element("span", {}, clip.label || clip.role || `motion ${clip.index + 1}`));
      if (clip.role && clip.label) button.append(element("small", {}, clip.role));
      if (this.overlaid) button.style.setProperty("--dot", EACH[clip.index % EACH.length]);
      button.style.left = `${100 * left}%`;
      button.style.top = `calc(${100 * top}% + ${2.4 * k}rem)`;
      button.addEventListener("click", () => this.solo(clip.index));
      return button;
    }));
    names.replaceChildren(...buttons);
    const seams = panels.filter(({ left, top }) => left > 0 || top > 0).map(({ left, top, width, height }) => {
      const seam = element("i", { class: "seam" });
      Object.assign(seam.style, { left: `${100 * left}%`, top: `${100 * top}%`, width: `${100 * width}%`, height: `${100 * height}%` });
      seam.dataset.aside = left > 0;
      seam.dataset.under = top > 0;
      return seam;
    });
    names.append(...seams);
  }

  solo(index) {
    this.only = this.only === index || !this.clips[index] ? -1 : index;
    this.say(this.only < 0 ? "all motions" : `only ${this.clips[this.only].label}`);
    this.labels();
    this.changed();
  }

  toggle(id, property, changed = () => {}) {
    const button = $(id);
    const show = () => button.setAttribute("aria-pressed", this[property]);
    button.addEventListener("click", () => {
      this[property] = !this[property];
      show();
      changed();
      this.changed();
    });
    show();
  }

  controls() {
    const scrubber = $("scrubber");
    Object.assign(scrubber, { max: this.duration, step: "any" });
    scrubber.addEventListener("input", () => {
      this.play(false);
      this.seek(Number(scrubber.value));
    });
    $("play").addEventListener("click", () => this.play());
    $("back").addEventListener("click", () => this.stepBy(-1));
    $("on").addEventListener("click", () => this.stepBy(1));
    const rate = $("rate");
    rate.append(...RATES.map((value) => element("option", { value, selected: value === 1 }, `${value}×`)));
    rate.addEventListener("change", () => { this.rate = Number(rate.value); });
    this.toggle("loop", "looping");
    this.toggle("bones", "bones");
    this.toggle("follow", "following");
    this.toggle("cameras", "cameras");
    this.toggle("overlay", "overlaid", () => this.labels());
    $("overlay").hidden = this.clips.length < 2;
    $("reset").addEventListener("click", () => this.orbit.reset());
    this.paints = [...document.querySelectorAll("input[name=colours]")];
    for (const paint of this.paints) paint.addEventListener("change", () => { this.colours = paint.value; this.changed(); });
    $("help-open").addEventListener("click", () => $("help").showModal());
    $("theme").addEventListener("click", () => {
      document.documentElement.dataset.theme = this.dark ? "light" : "dark";
      this.retheme();
    });
    document.addEventListener("keydown", (event) => this.pressed(event));
  }

  retheme() {
    const [red, green, blue] = getComputedStyle(document.body).backgroundColor.match(/[\d.]+/g).map(Number);
    this.dark = red + green + blue < 380;
    this.changed();
  }

  watch() {
    this.visible = true;
    new IntersectionObserver(([entry]) => { this.visible = entry.isIntersecting; this.changed(); }).observe(this.canvas);
    new ResizeObserver(() => { this.fit(); this.labels(); this.changed(); }).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.retheme());
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => location.reload());
    this.retheme();
  }

  pressed(event) {
    const on = document.activeElement;
    if (event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
    if (on?.matches("select, textarea, input:not([type=range]):not([type=radio])")) return;
    const inRange = on?.matches("input[type=range], input[type=radio]") && /^(Arrow|Home|End|Page)/.test(event.key);
    const onButton = on?.matches("button:focus-visible, summary, a[href]") && [" ", "Enter"].includes(event.key);
    if (inRange || onButton) return;
    const click = (id) => () => $(id).hidden || $(id).click();
    const staged = on === this.canvas;
    const keys = {
      " ": () => this.play(), k: () => this.play(), "?": click("help-open"), h: click("help-open"),
      ArrowLeft: () => (staged && event.shiftKey ? this.orbit.turn(-0.12, 0) : this.stepBy(event.shiftKey ? -10 : -1)),
      ArrowRight: () => (staged && event.shiftKey ? this.orbit.turn(0.12, 0) : this.stepBy(event.shiftKey ? 10 : 1)),
      ArrowUp: staged && (() => (event.shiftKey ? this.orbit.turn(0, 0.09) : this.orbit.magnify(1.12))),
      ArrowDown: staged && (() => (event.shiftKey ? this.orbit.turn(0, -0.09) : this.orbit.magnify(1 / 1.12))),
      w: () => this.orbit.slide(0, 24, this.canvas), s: () => this.orbit.slide(0, -24, this.canvas),
      a: () => this.orbit.slide(24, 0, this.canvas), d: () => this.orbit.slide(-24, 0, this.canvas),
      "+": () => this.orbit.magnify(1.12), "=": () => this.orbit.magnify(1.12), "-": () => this.orbit.magnify(1 / 1.12),
      Home: staged && (() => this.seek(0)), End: staged && (() => this.seek(this.duration)),
      ",": () => this.hasten(-1), ".": () => this.hasten(1),
      "[": () => this.orbit.turn(-0.12, 0), "]": () => this.orbit.turn(0.12, 0),
      l: click("loop"), b: click("bones"), f: click("follow"), v: click("cameras"), o: click("overlay"),
      r: click("reset"), t: click("theme"), c: () => this.paints[(this.paints.findIndex((p) => p.checked) + 1) % 3].click(),
    };
    const act = /^\d$/.test(event.key) ? () => this.solo(event.key === "0" ? -1 : Number(event.key) - 1) : keys[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }

  hasten(by) {
    const rate = $("rate");
    rate.selectedIndex = clamp(rate.selectedIndex + by, 0, RATES.length - 1);
    this.rate = Number(rate.value);
    this.say(`${this.rate} times`);
  }
}

function start() {
  const data = JSON.parse($("data").textContent);
  let viewer;
  try {
    viewer = new Viewer(data);
  } catch (error) {
    $("unable").textContent = `This browser cannot draw the moving bodies (${error.message}); below are poses instead.`;
    document.documentElement.dataset.lively = "false";
    return;
  }
  document.documentElement.dataset.lively = "true";
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) viewer.play(true);
  else viewer.seek(viewer.duration / 2);
  // For the curious at the console, and for tests.
  window.refine = {
    joints: (motion, seconds) => Array.from(viewer.clips[motion].pose(seconds).joints),
    seek: (seconds) => viewer.seek(seconds),
    play: (playing) => viewer.play(playing),
    get seconds() { return viewer.seconds; },
    get playing() { return viewer.playing; },
  };
}

start();
