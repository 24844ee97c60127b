// What is drawn of a motion at a moment: the colours of its body, its path, its joints, the loop's cameras.

const PARTS = {
  torso: "#8d99ae",
  left_arm: "#e76f51",
  right_arm: "#2a9d8f",
  left_leg: "#f4a259",
  right_leg: "#4f7cac",
};
const HEAD = "#e5c29f"; // of neck and head, which belong to the torso otherwise
const HEAT = ["#efe3cf", "#fcd28b", "#f58f5c", "#c8446b", "#5c2a72"];
// Of motions laid over one another.
const EACH = ["#d1495b", "#00798c", "#edae49", "#7b6fd0", "#66a182", "#5b7fa6", "#d98bb5", "#8f6a4e", "#b3bf3f"];
const PAPER = "#f7f5f0"; // of the loop's pictures
const [BRIGHT, DARK] = [
  [0.95, 0.95, 0.92],
  [0.11, 0.13, 0.22],
]; // of bones
const SCREEN = 0.9; // how far before and behind the body a camera's box reaches, in half widths of its picture

const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);

function heat(share) {
  const at = clamp(share, 0, 1) * (HEAT.length - 1);
  const low = Math.min(Math.floor(at), HEAT.length - 2);
  return mixed(rgb(HEAT[low]), rgb(HEAT[low + 1]), at - low);
}

// A colour for each joint; vertices mix those of the joints that they follow.
function tintsOf(viewer, clip, scene) {
  const { partOf, partNames, count, names } = viewer.skeleton;
  const colours = new Float32Array(3 * count);
  const speeds = clip.speedsAt(viewer.seconds);
  for (let joint = 0; joint < count; joint++) {
    const part = Math.max(0, partOf[joint]); // the pelvis is in none and goes with the torso
    let colour = scene.plain;
    if (viewer.colours === "motion") colour = heat(Math.sqrt(speeds[part] / viewer.greatest));
    else if (viewer.overlaid) colour = rgb(EACH[clip.index % EACH.length]);
    else if (viewer.colours === "parts") {
      colour = rgb(["neck", "head"].includes(names[joint]) ? HEAD : PARTS[partNames[part]]);
    }
    colours.set(colour, 3 * joint);
  }
  return colours;
}

// Lines under, among and over the body, and pictures that stand in the world.
function annotate(viewer, { clip, joints }, marks, scene, ratio) {
  drawPath(viewer, clip, marks, scene.ink, ratio);
  if (viewer.bones) drawBones(viewer, joints, marks, ratio);
  const made = viewer.looking?.made.find(({ motion }) => motion === clip.index);
  if (viewer.cameras && made && !viewer.overlaid) standCameras(viewer, made, clip, marks, scene.ink, ratio);
}

function drawPath(viewer, { fps, frames, path }, marks, ink, ratio) {
  const every = Math.max(1, Math.round(fps / 12));
  const at = (frame) => [path[3 * frame], 0, path[3 * frame + 2]];
  for (let frame = 0; frame + every < frames; frame += every) {
    const passed = frame / fps <= viewer.seconds;
    marks.under.push([at(frame), at(frame + every), [...ink, passed ? 0.4 : 0.14], 2 * ratio]);
  }
}

function drawBones(viewer, joints, marks, ratio) {
  const at = (joint) => [...joints.subarray(3 * joint, 3 * joint + 3)];
  const [line, dot] = viewer.dark ? [BRIGHT, DARK] : [DARK, [1, 1, 1]];
  const { parents } = viewer.skeleton;
  parents.forEach((up, joint) => {
    if (up >= 0) marks.over.push([at(up), at(joint), [...line, 0.85], 2.4 * ratio]);
  });
  parents.forEach((_, joint) => {
    marks.over.push([at(joint), at(joint), [...line, 1], 7.5 * ratio]);
    marks.over.push([at(joint), at(joint), [...dot, 1], 4 * ratio]);
  });
}

// The loop's cameras: by weak perspective they see along parallel lines, so that a box is what they see. The picture
// hangs at its back.
function standCameras(viewer, made, clip, marks, ink, ratio) {
  const frame = clamp(Math.round(viewer.seconds * clip.fps), 0, clip.frames - 1);
  const { moments, stages } = viewer.looking;
  for (let view = 0; view < made.views; view++) {
    const chosen = view === viewer.loop.view;
    const first = 12 * (made.views * frame + view);
    const through = [0, 3, 6, 9].map((at) => [...made.corners.subarray(first + at, first + at + 3)]);
    const across = subtract(through[1], through[0]);
    const forward = normalised(cross(across, subtract(through[3], through[0])));
    const way = scaled(forward, (SCREEN * Math.hypot(...across)) / 2);
    const lens = through.map((corner) => subtract(corner, way));
    const screen = through.map((corner) => add(corner, way));
    for (let k = 0; k < 4; k++) {
      const next = (k + 1) % 4;
      marks.among.push([screen[k], screen[next], [...ink, chosen ? 0.5 : 0.16], (chosen ? 1.6 : 1) * ratio]);
      marks.among.push([lens[k], screen[k], [...ink, chosen ? 0.22 : 0.1], ratio]);
      marks.among.push([lens[k], lens[next], [...ink, chosen ? 0.3 : 0.1], ratio]);
    }
    if (!chosen) continue;
    const cell = [viewer.loop.nearest(frame) / moments.length, stages.indexOf("composition") / stages.length];
    const window = [...cell, 1 / moments.length, 1 / stages.length];
    const picture = { url: made.sheets[0][view], corners: screen, window, paper: rgb(PAPER) };
    marks.pictures.push({ ...picture, veil: viewer.dark ? 0.05 : 0.16 });
  }
}
