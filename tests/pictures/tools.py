"""Take the picture of a clip in other programs, as README shows it.

    python tests/pictures/tools.py OUT_DIR

Writes tools.png: the sample take on Mixamo's rig as FBX, rendered by Blender, and as
GLB in three.js. Needs ``KINEFILTER_BLENDER`` and ``KINEFILTER_THREE`` as the tests of
FBX and GLB, and Debian's chromium and chromium-driver.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1]))

from browser import Browser

from kinefilter import clean, read_take
from kinefilter.pipeline.formats import Export, write_clip
from kinefilter.scenes import SAMPLE

SIZE = 500, 480  # pixels of each half
BARS = 160  # of a window, which is that much larger than its page
FRAME, RATE = 75, 30  # of the sample take: the punch
PAGE = """<!doctype html><body style="margin:0"><script type="importmap">
{"imports": {"three": "/three/node_modules/three/build/three.module.js",
"three/addons/": "/three/node_modules/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
const looks = { antialias: true, preserveDrawingBuffer: true };
const renderer = new THREE.WebGLRenderer(looks);
renderer.setSize(WIDTH, HEIGHT);
document.body.append(renderer.domElement);
const scene = new THREE.Scene();
scene.background = new THREE.Color(0xe8ebee);
const gltf = await new GLTFLoader().loadAsync('/clip.glb');
const mixer = new THREE.AnimationMixer(gltf.scene);
mixer.clipAction(gltf.animations[0]).play();
mixer.setTime(TIME);
scene.add(gltf.scene, new THREE.GridHelper(20, 40, 0x8899aa, 0xb8c2cc));
const sun = new THREE.DirectionalLight(0xffffff, 2.5);
sun.position.set(-2, 4, -3);
scene.add(sun, new THREE.AmbientLight(0xffffff, 1.2));
const hips = new THREE.Vector3();
gltf.scene.updateMatrixWorld(true);
gltf.scene.getObjectByProperty('isBone', true).getWorldPosition(hips);
const camera = new THREE.PerspectiveCamera(28, WIDTH / HEIGHT);
camera.position.set(hips.x - 1.8, 1.5, hips.z - 4.2);
camera.lookAt(hips.x, 0.95, hips.z);
renderer.render(scene, camera);
document.title = 'drawn';
</script>"""


class Handler(SimpleHTTPRequestHandler):
    """Serves the folder, and three.js below /three/."""

    def translate_path(self, path: str) -> str:
        if path.startswith("/three/"):
            return os.environ["KINEFILTER_THREE"] + path.removeprefix("/three")
        return super().translate_path(path)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


def in_three(folder: Path) -> Image.Image:
    """Return what three.js shows of ``clip.glb``."""
    numbers = {"WIDTH": SIZE[0], "HEIGHT": SIZE[1], "TIME": FRAME / RATE}
    page = PAGE
    for name, number in numbers.items():
        page = page.replace(name, str(number))
    (folder / "page.html").write_text(page, encoding="utf-8")
    handler = partial(Handler, directory=str(folder))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with Browser(size=(SIZE[0], SIZE[1] + BARS), webgl=True) as browser:
        browser.open(f"http://127.0.0.1:{server.server_port}/page.html")
        while browser.run("return document.title") != "drawn":
            pass
        shot = Image.open(BytesIO(browser.screenshot())).convert("RGB")
    server.shutdown()
    return shot.crop((0, 0, *SIZE))


def in_blender(folder: Path) -> Image.Image:
    """Return what Blender renders of ``clip.fbx``."""
    script, out = Path(__file__).with_name("blender_bones.py"), folder / "blender.png"
    words = [folder / "clip.fbx", FRAME + 1, out, *SIZE]
    program = os.environ["KINEFILTER_BLENDER"]
    subprocess.run([program, script, *map(str, words)], check=True)
    return Image.open(out).convert("RGB")


if __name__ == "__main__":
    clip = clean(read_take(SAMPLE)).clip
    blender = os.environ["KINEFILTER_BLENDER"]
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        write_clip(clip, work / "clip.fbx", Export(rig="mixamo", blender=blender))
        write_clip(clip, work / "clip.glb")
        both = np.hstack([in_blender(work), in_three(work)])
    shown = Image.fromarray(both).quantize(128)
    shown.save(Path(sys.argv[1]) / "tools.png", optimize=True)
