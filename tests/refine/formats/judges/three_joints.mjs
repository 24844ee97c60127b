// Where three.js has the joints: node three_joints.mjs NODE_MODULES FILE CLIP SECONDS... prints JSON.
import fs from 'node:fs';
import path from 'node:path';
import { pathToFileURL } from 'node:url';

globalThis.self = globalThis;
globalThis.ProgressEvent = class {};

const [modules, file, clip, ...seconds] = process.argv.slice(2);
const load = (name) => import(pathToFileURL(path.join(modules, 'three', name)).href);
const THREE = await load('build/three.module.js');
const { GLTFLoader } = await load('examples/jsm/loaders/GLTFLoader.js');

const bytes = fs.readFileSync(file);
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const gltf = await new Promise((resolve, reject) => new GLTFLoader().parse(buffer, '', resolve, reject));
const mixer = new THREE.AnimationMixer(gltf.scene);
const action = mixer.clipAction(gltf.animations[Number(clip)]);
action.setLoop(THREE.LoopOnce, 1);
action.clampWhenFinished = true;
action.play();

const joints = [];
for (const second of seconds) {
  mixer.setTime(Number(second));
  gltf.scene.updateMatrixWorld(true);
  const place = {};
  gltf.scene.traverse((thing) => {
    if (thing.isBone) place[thing.userData.name || thing.name] = thing.getWorldPosition(new THREE.Vector3()).toArray();
  });
  joints.push(place);
}
const clips = gltf.animations.map((animation) => [animation.name, animation.duration]);
console.log(JSON.stringify({ joints, clips }));
