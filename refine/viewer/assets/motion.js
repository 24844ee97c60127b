// Clips and the body that performs them; forward kinematics as renderers/skeleton.py does it.

const TYPES = { Float32Array, Int16Array, Uint16Array, Uint32Array, Uint8Array };
const CALM = 0.6; // seconds over which a path is averaged, so that a camera that follows does not shake

function unpacker(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  return ({ at, type, shape }) =>
    new TYPES[type](
      bytes.buffer,
      at,
      shape.reduce((a, b) => a * b, 1),
    );
}

class Skeleton {
  constructor(body, array) {
    this.parents = body.parents;
    this.names = body.names;
    this.rest = array(body.rest);
    this.count = this.parents.length;
    this.partNames = Object.keys(body.parts);
    this.partOf = this.parents.map((_, joint) => this.partNames.findIndex((part) => body.parts[part].includes(joint)));
  }
}

class Clip {
  constructor(entry, array, skeleton, index) {
    Object.assign(this, { index, skeleton, label: entry.label, role: entry.role });
    Object.assign(this, { fps: entry.fps, frames: entry.frames, seconds: entry.seconds, numbers: entry.numbers });
    this.name = this.label || this.role || `motion ${index + 1}`;
    this.quaternions = array(entry.quaternions);
    this.root = array(entry.root);
    this.speeds = array(entry.speeds);
    this.speed = entry.speed;
    this.rotations = new Float64Array(4 * skeleton.count);
    this.path = this.smoothedPath();
  }

  // The two frames about a moment and the share of the second; a clip that is over rests in its last frame.
  between(seconds) {
    const at = clamp(seconds * this.fps, 0, this.frames - 1);
    const low = Math.min(Math.floor(at), Math.max(0, this.frames - 2));
    return [low, Math.min(low + 1, this.frames - 1), at - low];
  }

  row(values, width, seconds) {
    const [low, high, share] = this.between(seconds);
    return Array.from({ length: width }, (_, k) => mix(values[low * width + k], values[high * width + k], share));
  }

  place = (seconds) => this.row(this.root, 3, seconds);
  follow = (seconds) => this.row(this.path, 3, seconds);
  speedsAt = (seconds) => this.row(this.speeds, this.skeleton.partNames.length, seconds);

  // Where the pelvis is over the floor, averaged over time.
  smoothedPath() {
    const half = Math.round((CALM * this.fps) / 2);
    const path = new Float32Array(3 * this.frames);
    for (let frame = 0; frame < this.frames; frame++)
      for (const axis of [0, 2]) {
        let sum = 0;
        for (let k = -half; k <= half; k++) sum += this.root[3 * clamp(frame + k, 0, this.frames - 1) + axis];
        path[3 * frame + axis] = sum / (2 * half + 1);
      }
    return path;
  }

  // Fill `rotations` with unit quaternions, interpolated on the shorter side.
  turn(seconds) {
    const [low, high, share] = this.between(seconds);
    const { quaternions: q, rotations: out, skeleton } = this;
    const width = 4 * skeleton.count;
    for (let joint = 0; joint < skeleton.count; joint++) {
      const a = low * width + 4 * joint;
      const b = high * width + 4 * joint;
      const side = q[a] * q[b] + q[a + 1] * q[b + 1] + q[a + 2] * q[b + 2] + q[a + 3] * q[b + 3] < 0 ? -1 : 1;
      let square = 0;
      for (let k = 0; k < 4; k++) {
        const value = mix(q[a + k], side * q[b + k], share);
        out[4 * joint + k] = value;
        square += value * value;
      }
      const length = Math.sqrt(square) || 1;
      for (let k = 0; k < 4; k++) out[4 * joint + k] /= length;
    }
    return out;
  }

  // Joints [24 x 3] in metres, and for each joint the three rows of the matrix that carries the body at rest there.
  pose(seconds) {
    const { skeleton } = this;
    const { rest, parents, count } = skeleton;
    const q = this.turn(seconds);
    const turns = new Float64Array(9 * count);
    const joints = new Float32Array(3 * count);
    const bones = new Float32Array(12 * count);
    joints.set(this.place(seconds));
    for (let joint = 0; joint < count; joint++) {
      const [w, x, y, z] = q.subarray(4 * joint, 4 * joint + 4);
      const local = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
      ];
      const up = parents[joint];
      for (let row = 0; row < 3; row++) {
        for (let column = 0; column < 3; column++) {
          let sum = up < 0 ? local[3 * row + column] : 0;
          if (up >= 0) for (let k = 0; k < 3; k++) sum += turns[9 * up + 3 * row + k] * local[3 * k + column];
          turns[9 * joint + 3 * row + column] = sum;
        }
        if (up >= 0) {
          let sum = joints[3 * up + row];
          for (let k = 0; k < 3; k++) sum += turns[9 * up + 3 * row + k] * (rest[3 * joint + k] - rest[3 * up + k]);
          joints[3 * joint + row] = sum;
        }
        let carried = joints[3 * joint + row];
        for (let k = 0; k < 3; k++) {
          bones[12 * joint + 4 * row + k] = turns[9 * joint + 3 * row + k];
          carried -= turns[9 * joint + 3 * row + k] * rest[3 * joint + k];
        }
        bones[12 * joint + 4 * row + 3] = carried;
      }
    }
    return { joints, bones };
  }
}

// How far bodies reach: up, and aside from where a camera that follows (or one that does not) looks.
function extent(clips, following, middle) {
  let top = 0.5;
  let aside = 0.3;
  for (const clip of clips)
    for (let k = 0; k <= 24; k++) {
      const seconds = (clip.seconds * k) / 24;
      const { joints } = clip.pose(seconds);
      const centre = following ? clip.follow(seconds) : middle;
      for (let joint = 0; joint < joints.length; joint += 3) {
        top = Math.max(top, joints[joint + 1]);
        aside = Math.max(aside, Math.hypot(joints[joint] - centre[0], joints[joint + 2] - centre[2]));
      }
    }
  return { top: top + 0.2, aside: 0.88 * aside + 0.12 }; // limbs seldom reach their farthest right across the view
}
