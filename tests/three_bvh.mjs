// Print where three.js's BVHLoader puts the joints of a BVH file, as JSON.
//
//     node tests/three_bvh.mjs FOLDER clip.bvh FRAMES
//
// FOLDER has node_modules with three in it. Printed are "names" and, for each frame,
// "frames": [x, y, z] of each joint in the file's axes and unit.

import { readFileSync } from 'node:fs';
import { pathToFileURL } from 'node:url';

const [folder, file, frames] = process.argv.slice(2);
const load = (name) => import(pathToFileURL(`${folder}/node_modules/three/${name}`));
const THREE = await load('build/three.module.js');
const { BVHLoader } = await load('examples/jsm/loaders/BVHLoader.js');

const { skeleton, clip } = new BVHLoader().parse(readFileSync(file, 'utf-8'));
const root = skeleton.bones[0];
const mixer = new THREE.AnimationMixer(root);
mixer.clipAction(clip).play();
// From one key to the next; beyond the last key a clip begins anew.
const times = clip.tracks[0].times;
const place = new THREE.Vector3();
const rows = [];
for (let k = 0; k < Number(frames); k++) {
	mixer.setTime(Math.min(times[k], clip.duration * (1 - 1e-7)));
	root.updateMatrixWorld(true);
	rows.push(skeleton.bones.map((bone) => bone.getWorldPosition(place).toArray()));
}
const names = skeleton.bones.map((bone) => bone.name);
console.log(JSON.stringify({ names, keys: times.length, step: times[1], frames: rows }));
