// Print what Khronos' validator says of a GLB file, and where three.js has its joints.
//
//     node tests/three_gltf.mjs FOLDER clip.glb [TIMES]
//
// FOLDER has node_modules with three, gltf-validator and @pixiv/three-vrm-animation in
// it. TIMES is a list in JSON, in seconds; without, they are those of the first node's
// keys. Printed are, as JSON, "issues" (code and place of each), "times", "names" and,
// for each time, "frames": [x, y, z] of each joint in meters, "extras" of the animation,
// "reliability" unpacked from them, a list for each joint, and of VRMA "bones": how they
// turn (xyzw), and where the hips are.

import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { pathToFileURL } from 'node:url';

const [folder, file, asked] = process.argv.slice(2);
const load = (name) => import(pathToFileURL(`${folder}/node_modules/three/${name}`));
const THREE = await load('build/three.module.js');
const { GLTFLoader } = await load('examples/jsm/loaders/GLTFLoader.js');
const validator = createRequire(`${folder}/`)('gltf-validator');

const bytes = new Uint8Array(readFileSync(file));
const { issues } = await validator.validateBytes(bytes);
const loader = new GLTFLoader();
let plugin = () => ({ name: 'none' });
if (file.endsWith('.vrma')) {
	const { VRMAnimationLoaderPlugin } = await load(
		'../@pixiv/three-vrm-animation/lib/three-vrm-animation.module.js',
	);
	plugin = (parser) => new VRMAnimationLoaderPlugin(parser);
}
const gltf = await loader.register(plugin).parseAsync(bytes.buffer, '');
const [clip] = gltf.animations;
const mixer = new THREE.AnimationMixer(gltf.scene);
mixer.clipAction(clip).play();
const joints = [];
gltf.scene.traverse((node) => node.isBone && joints.push(node));
const place = new THREE.Vector3();
const times = asked ? JSON.parse(asked) : Array.from(clip.tracks[0].times);
const frames = times.map((time) => {
	mixer.setTime(Math.min(time, clip.duration * (1 - 1e-7)));
	gltf.scene.updateMatrixWorld(true);
	return joints.map((joint) => joint.getWorldPosition(place).toArray());
});
const [vrma] = gltf.userData.vrmAnimations ?? [];
const bones = vrma && {
	hips: Array.from(vrma.humanoidTracks.translation.get('hips').values),
	turns: Object.fromEntries(
		[...vrma.humanoidTracks.rotation].map(([name, { values }]) => [name, Array.from(values)]),
	),
	rest: vrma.restHipsPosition.toArray(),
};
const names = joints.map((joint) => joint.userData.name ?? joint.name);
const told = issues.messages.map(({ code, pointer }) => `${code} ${pointer}`);
const extras = clip.userData;
const { reliability: packed, joints: columns } = extras.kinefilter;
const reliability = packed && (await unpacked(packed, columns.length));
console.log(JSON.stringify({ issues: told, times, names, frames, bones, extras, reliability }));

async function unpacked(text, width) {
	const compressed = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
	const stream = new Blob([compressed]).stream();
	const inflated = stream.pipeThrough(new DecompressionStream('deflate'));
	const numbers = Array.from(new Int32Array(await new Response(inflated).arrayBuffer()));
	const count = numbers.length / width;
	return Array.from({ length: width }, (_, n) => numbers.slice(n * count, (n + 1) * count));
}
