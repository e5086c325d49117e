"""Blender and three.js put other people's rigs where the retargeted motion has them."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rig_motions import performed

from kinefilter.characters import Clip
from kinefilter.pipeline.formats import Export, write_clip
from kinefilter.retarget.retargeting import retarget
from kinefilter.retarget.rig_map import RIGS, load_rig_map
from kinefilter.retarget.target_rig import built_rig

Array = NDArray[np.float64]
MILLIMETER = 1e-3

BLENDER = os.environ.get("KINEFILTER_BLENDER") or (
    sys.executable if importlib.util.find_spec("bpy") else ""
)
THREE = os.environ.get("KINEFILTER_THREE", "")


@pytest.fixture(scope="module")
def clip() -> Clip:
    """Return a walk of twelve frames."""
    return performed("walk").at(slice(40, 52))


def motion(clip: Clip, name: str) -> tuple[list[str], Array]:
    """Return names and positions of the joints of a rig."""
    rig = built_rig(load_rig_map(name), clip.body)
    return list(rig.rest.names), retarget(clip, rig).positions


@pytest.mark.skipif(
    not THREE or shutil.which("node") is None,
    reason="no three.js: see test_three.py for how to install it",
)
@pytest.mark.parametrize("name", RIGS)
def test_threes_joints_are_where_the_motion_has_them(
    clip: Clip, tmp_path: Path, name: str
) -> None:
    path = tmp_path / "clip.bvh"
    write_clip(clip, path, Export(rig=name))
    # three.js moves no joint that has a colon in its name.
    path.write_text(path.read_text().replace("mixamorig:", ""))
    script = Path(__file__).with_name("three_bvh.mjs")
    command = ["node", str(script), THREE, str(path), str(len(clip))]
    ran = subprocess.run(command, check=True, capture_output=True, timeout=60)
    three = json.loads(ran.stdout)
    names, wanted = motion(clip, name)
    columns = [three["names"].index(joint.rpartition(":")[2]) for joint in names]
    found = np.array(three["frames"])[:, columns]
    assert np.linalg.norm(found - wanted, axis=-1).max() < MILLIMETER


@pytest.mark.skipif(
    not BLENDER, reason="no Blender: see test_blender.py for how to install it"
)
def test_blenders_joints_are_where_the_motion_has_them(
    clip: Clip, tmp_path: Path
) -> None:
    files = {f"{name}.{suffix}": name for name in RIGS for suffix in ("bvh", "usdc")}
    for file, name in files.items():
        write_clip(clip, tmp_path / file, Export(rig=name))
        np.save(tmp_path / f"{file}.frames.npy", np.arange(len(clip), dtype=float))
    script = Path(__file__).with_name("blender_import.py")
    subprocess.run([BLENDER, str(script), str(tmp_path)], check=True, timeout=300)
    for file, name in files.items():
        blender = dict(np.load(tmp_path / f"{file}.npz"))
        names, wanted = motion(clip, name)
        if file.endswith(".usdc"):
            names = [joint.replace(":", "_") for joint in names]
        heads = blender["heads"][:, [blender["names"].tolist().index(n) for n in names]]
        z_up = np.stack([wanted[..., 0], -wanted[..., 2], wanted[..., 1]], axis=-1)
        assert np.linalg.norm(heads - z_up, axis=-1).max() < MILLIMETER, file
