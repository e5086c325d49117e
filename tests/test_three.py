"""three.js's BVHLoader puts every joint where kinefilter says."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from skeletons import every_skeleton

from kinefilter.characters import Clip, Skeleton
from kinefilter.pipeline.formats import Export, write_clip
from kinefilter.pipeline.formats.export import resampled

MakeClip = Callable[..., Clip]
MILLIMETER = 1e-3

FOLDER = os.environ.get("KINEFILTER_THREE", "")
pytestmark = pytest.mark.skipif(
    not FOLDER or shutil.which("node") is None,
    reason="no three.js: install Node and, in an empty folder, npm install "
    "three@0.187.0, then KINEFILTER_THREE=that folder pytest",
)


@every_skeleton
@pytest.mark.parametrize(
    "export",
    [
        Export(),
        Export(units="cm", rotation_order="xyz"),
        Export(rotation_order="zxy", rest="t"),
        Export(rotation_order="yxz", fps=24.0),
        Export(up="z", rotation_order="xzy"),
        Export(rotation_order="yzx"),
    ],
    ids=lambda export: export.rotation_order,
)
def test_every_joint_is_where_the_clip_has_it_in_every_frame(
    make_clip: MakeClip, tmp_path: Path, skeleton: Skeleton, export: Export
) -> None:
    clip = make_clip(30, skeleton, seed=5)
    path = tmp_path / "clip.bvh"
    write_clip(clip, path, export)
    clip = resampled(clip, export.fps) if export.fps else clip
    script = Path(__file__).with_name("three_bvh.mjs")
    command = ["node", str(script), FOLDER, str(path), str(len(clip))]
    ran = subprocess.run(command, check=True, capture_output=True, timeout=60)
    three = json.loads(ran.stdout)
    assert three["keys"] == len(clip)
    assert three["step"] == pytest.approx(1.0 / clip.fps)
    columns = [three["names"].index(joint) for joint in skeleton.joints]
    found = np.array(three["frames"])[:, columns] * export.meters_per_unit
    away = np.linalg.norm(found - export.axes(clip.positions), axis=-1)
    assert away.shape == (len(clip), len(skeleton))
    assert away.max() < MILLIMETER
