"""Motions for learning and robots: what other programs make of the arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rig_motions import performed
from scipy.spatial.transform import Rotation

from kinefilter.characters import Clip, InputError
from kinefilter.pipeline.formats import Export, read_clip, write_clip
from kinefilter.pipeline.formats.clips import target_rig
from kinefilter.retarget.retargeting import retarget

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def clip() -> Clip:
    """Return half a walk."""
    return performed("walk").at(slice(40, 70))


def arrays_of(clip: Clip, path: Path, rig: str) -> dict[str, Array]:
    write_clip(clip, path, Export(rig=rig))
    with np.load(path, allow_pickle=False) as archive:
        return dict(archive)


def z_up(points: Array) -> Array:
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


@pytest.mark.parametrize("rig", ["lafan1", "mixamo", "smplx", "unreal"])
def test_joints_are_where_the_rig_has_them_with_z_up(
    clip: Clip, tmp_path: Path, rig: str
) -> None:
    found = arrays_of(clip, tmp_path / "clip.npz", rig)
    target = target_rig(rig, None, clip.body)
    wanted = z_up(retarget(clip, target).positions)
    np.testing.assert_allclose(found["global_joint_positions"], wanted, atol=1e-9)
    assert tuple(found["joint_names"].tolist()) == target.rest.names
    assert tuple(found["parents"].tolist()) == target.rest.parents
    assert (found["fps"], found["height"]) == (30.0, clip.body.height)
    # From a joint to its child it is always the same way in its own axes.
    turns, places = found["global_joint_orientations"], found["global_joint_positions"]
    for n, parent in enumerate(target.rest.parents[2:], start=2):
        if n in target.followed:  # an IK bone moves against its parent
            continue
        own = Rotation.from_quat(turns[:, parent], scalar_first=True).inv()
        bone = own.apply(places[:, n] - places[:, parent])
        assert np.ptp(bone, axis=0).max() < 1e-9


@pytest.mark.parametrize(("rig", "joints"), [("smpl", 52), ("smplx", 55)])
def test_the_poses_of_amass_put_every_joint_where_it_is(
    clip: Clip, tmp_path: Path, rig: str, joints: int
) -> None:
    """Forward kinematics as SMPL's: rotation vectors, from the pelvis outwards."""
    found = arrays_of(clip, tmp_path / "clip.npz", rig)
    rest = target_rig(rig, None, clip.body).rest
    assert found["poses"].shape == (len(clip), 3 * joints)
    assert not found["poses"][:, 66:].any()
    vectors = found["poses"].reshape(len(clip), joints, 3)
    turns, places = {-1: Rotation.identity()}, {}
    for n, parent in enumerate(rest.parents[:22]):
        turns[n] = turns[parent] * Rotation.from_rotvec(vectors[:, n])
        if parent < 0:
            places[n] = found["trans"]
        else:
            bone = rest.positions[n] - rest.positions[parent]
            places[n] = places[parent] + turns[parent].apply(bone)
        away = places[n] - found["global_joint_positions"][:, n]
        assert np.abs(away).max() < 1e-9, rest.names[n]
    assert found["trans"][:, 2].min() > 0.7  # the pelvis over the floor
    assert not found["betas"].any()
    assert str(found["gender"]) == "neutral"
    assert found["mocap_framerate"] == found["mocap_frame_rate"] == 30.0


def test_the_parts_of_smplx_are_those_of_its_poses(clip: Clip, tmp_path: Path) -> None:
    found = arrays_of(clip, tmp_path / "clip.npz", "smplx")
    names = ("root_orient", "pose_body", "pose_jaw", "pose_eye", "pose_hand")
    parts = [found[name] for name in names]
    assert [part.shape[1] for part in parts] == [3, 63, 3, 6, 90]
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), found["poses"])


def test_frames_are_even(clip: Clip, tmp_path: Path) -> None:
    some = clip.at(np.delete(np.arange(30), [4, 5, 17]))
    found = arrays_of(some, tmp_path / "clip.npz", "smplx")
    assert (len(found["poses"]), found["fps"]) == (30, 30.0)


def test_they_are_not_taken_for_clips(clip: Clip, tmp_path: Path) -> None:
    arrays_of(clip, tmp_path / "clip.npz", "smplx")
    with pytest.raises(InputError, match="not a kinefilter clip"):
        read_clip(tmp_path / "clip.npz")
