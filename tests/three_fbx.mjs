// Print where three.js has the joints of an FBX file, and how they are turned.
//
//     node tests/three_fbx.mjs FOLDER clip.fbx FRAMES
//
// FOLDER has node_modules with three in it. Printed are, as JSON, the "names" of the
// joints and, for each of so many frames, 30 a second, "frames": [x, y, z] of each
// joint in the file's unit, and its world rotation as xyzw.

import { readFileSync } from 'node:fs';
import { pathToFileURL } from 'node:url';

const [folder, file, count] = process.argv.slice(2);
const load = (name) => import(pathToFileURL(`${folder}/node_modules/three/${name}`));
const THREE = await load('build/three.module.js');
const { FBXLoader } = await load('examples/jsm/loaders/FBXLoader.js');

globalThis.window = globalThis; // it asks both for what images need
globalThis.document = { createElementNS: () => ({}) };
const bytes = new Uint8Array(readFileSync(file));
const scene = new FBXLoader().parse(bytes.buffer, '');
const mixer = new THREE.AnimationMixer(scene);
mixer.clipAction(scene.animations[0]).play();
const joints = [];
scene.traverse((node) => node.isBone && joints.push(node));
const place = new THREE.Vector3();
const turn = new THREE.Quaternion();
const frames = Array.from({ length: Number(count) }, (_, k) => {
	mixer.setTime((k / 30) * (1 - 1e-9));
	scene.updateMatrixWorld(true);
	return joints.map((joint) => [
		...joint.getWorldPosition(place).toArray(),
		...joint.getWorldQuaternion(turn).toArray(),
	]);
});
const names = joints.map((joint) => joint.name);
console.log(JSON.stringify({ names, frames }));
