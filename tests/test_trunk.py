"""Hips and shoulders where the sensor does not see which way they face."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_motions import performed, yaw_of
from numpy.typing import NDArray
from real_data import DATA, recorded
from skeletons import every_skeleton

from kinefilter import clean, read_take
from kinefilter.characters import KINECT_V2, Skeleton
from kinefilter.characters.rotations import about_x, rotate, wrapped
from kinefilter.pipeline.failures import find_failures, repaired
from kinefilter.pipeline.failures.sides import swapped_back
from kinefilter.pipeline.failures.trunk import steadied
from kinefilter.pipeline.merge.alignment import IDENTITY
from kinefilter.pipeline.merge.session import fuse
from kinefilter.retarget import HeadingFrame
from kinefilter.scenes.library import MOTIONS

Array = NDArray[np.float64]


def _yaw_of(positions: Array, skeleton: Skeleton, part: str) -> Array:
    left, right = skeleton.sides(part)
    line = positions[:, left] - positions[:, right]
    return np.arctan2(-line[:, 2], line[:, 0])


@pytest.mark.parametrize("shaky", [0.0, 50.0])
@pytest.mark.parametrize("lean", [0.0, 0.3])
def test_the_trunk_turns_evenly_where_its_heading_jumps(
    shaky: float, lean: float
) -> None:
    """The shorter way, even where the jump itself looks like more than half a turn.

    The sensor saw how the person leaned, so spine and head stay where they are.
    """
    take, skeleton = performed("stand_idle"), KINECT_V2
    jump, change = np.radians(140.0), 60
    frames = np.arange(len(take)) >= change
    yaw = np.where(frames, jump, 0.0)
    yaw[change - 2 : change + 2] += np.radians([-shaky, -shaky, shaky, shaky])
    frame = HeadingFrame(take.positions[:, 0], yaw)
    turned = frame.restore(frame.unturned.remove(take.positions))
    root = turned[:, :1]
    turned = root + rotate(about_x(np.array(lean)), turned - root)
    seen = replace(take, positions=turned)
    mended = swapped_back(seen.swapped(frames), np.stack([frames, frames], 1))
    middle = skeleton.mirror == np.arange(len(skeleton))
    np.testing.assert_allclose(mended.positions[:, middle], turned[:, middle])
    away = np.unwrap(yaw_of(mended)) - np.unwrap(yaw_of(take))
    around = np.abs(take.time - take.time[change]) < 0.3
    speed = np.diff(away)[around[1:]] / np.diff(take.time)[around[1:]]
    np.testing.assert_allclose(speed, jump / 0.7, rtol=0.15 if lean == 0.0 else 0.4)
    if lean == 0.0:
        assert np.abs(away[:45]).max() < 1e-9
        assert np.abs(away[75:] - jump).max() < 1e-9


@pytest.mark.parametrize(("seconds", "jumps"), [(0.0, True), (0.2, False)])
def test_a_trunk_turns_evenly_that_turns_within_a_frame(
    seconds: float, *, jumps: bool
) -> None:
    """Sides do not change; whoever turns by 100 degrees in 0.2 s may do so."""
    take, jump, change = performed("stand_idle"), np.radians(100.0), 60
    yaw = np.interp(take.time, take.time[change - 1] + [0.0, seconds + 1e-3], [0, jump])
    frame = HeadingFrame(take.positions[:, 0], yaw)
    turned = frame.restore(frame.unturned.remove(take.positions))
    seen = replace(take, positions=turned)
    mended = steadied(seen, ())
    if not jumps:
        np.testing.assert_array_equal(mended.positions, turned)
        return
    away = np.unwrap(yaw_of(mended)) - np.unwrap(yaw_of(take))
    np.testing.assert_allclose(away[[40, 80]], [0.0, jump], atol=1e-9)
    assert np.diff(away).max() < 1.2 * jump / 21
    others = np.setdiff1d(
        np.arange(len(KINECT_V2)), [*KINECT_V2.hips, *KINECT_V2.sides("Shoulder")]
    )
    np.testing.assert_array_equal(mended.positions[:, others], turned[:, others])


@every_skeleton
@pytest.mark.parametrize("part", ["Hip", "Shoulder"])
@pytest.mark.parametrize("wrong", ["short", "wrung"])
def test_a_line_that_shows_nothing_turns_with_the_trunk(
    skeleton: Skeleton, part: str, wrong: str
) -> None:
    take = performed("walk", skeleton)
    ends, some = np.array(skeleton.sides(part)), slice(40, 55)
    seen = take.positions.copy()
    middle = seen[some][:, ends].mean(axis=1, keepdims=True)
    away = seen[some][:, ends] - middle
    away = 0.2 * away[..., ::-1] if wrong == "short" else -away * [1.0, 1.0, 0.8]
    seen[some, ends[0]], seen[some, ends[1]] = np.moveaxis(middle + away, 1, 0)
    mended = steadied(replace(take, positions=seen), ()).positions
    off = wrapped(_yaw_of(mended, skeleton, part) - _yaw_of(seen, skeleton, part))
    assert np.abs(off[some]).max() > np.radians(60.0)
    np.testing.assert_allclose(mended, take.positions, atol=0.03)
    others = np.setdiff1d(np.arange(len(skeleton)), ends)
    np.testing.assert_array_equal(mended[:, others], seen[:, others])


def test_a_trunk_stays_wide_where_sensors_disagree_which_way_it_faces() -> None:
    """For half a second, one of them shows it turned by 150 degrees."""
    take, ends = performed("stand_idle"), list(KINECT_V2.hips)
    ends += KINECT_V2.sides("Shoulder")
    yaw = np.where(np.abs(np.arange(len(take)) - 60) < 8, np.radians(150.0), 0.0)
    frame = HeadingFrame(take.positions[:, 0], yaw)
    turned = take.positions.copy()
    turned[:, ends] = frame.restore(frame.unturned.remove(turned))[:, ends]
    takes, scores = [take, replace(take, positions=turned)], np.ones(take.state.shape)
    found = fuse(takes, [scores, scores], [IDENTITY]).take
    assert found.positions.shape == take.positions.shape
    off = wrapped(np.diff(np.unwrap(yaw_of(found))))
    assert np.abs(off).max() < np.radians(15.0)
    for left, right in (ends[:2], ends[2:]):
        wide, usual = (
            np.linalg.norm(x.positions[:, left] - x.positions[:, right], axis=1)
            for x in (found, take)
        )
        assert (wide > 0.6 * usual).all()


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_trunk_that_is_seen_stays_as_it_is(motion: str) -> None:
    take = performed(motion)
    np.testing.assert_array_equal(steadied(take, ()).positions, take.positions)
    missing = replace(take, state=np.zeros_like(take.state))
    assert np.isnan(steadied(missing, ()).positions).all()
    together = take.positions.copy()
    together[:, take.skeleton.sides("Hip")] = together[:, :1]
    found = steadied(replace(take, positions=together), ()).positions
    np.testing.assert_allclose(found, together, atol=1e-3)  # and nothing is divided


@recorded
@pytest.mark.parametrize(
    ("name", "begin"), [("p06_90deg_walk_B", 9.9), ("p12_90deg_walk_A", 9.2)]
)
def test_recorded_trunks_are_not_wrung(name: str, begin: float) -> None:
    take = read_take(DATA / "two-kinects" / f"{name}.csv.gz")
    take = take.at(np.unique(take.time, return_index=True)[1])
    mended = repaired(take, find_failures(take))
    time = take.time - take.time[0]
    part = (time >= begin) & (time < begin + 0.6)
    hips, shoulders = (
        _yaw_of(mended.positions, take.skeleton, part) for part in ("Hip", "Shoulder")
    )
    assert np.abs(wrapped(hips - shoulders))[part].max() < np.radians(60.0)
    clip = clean(take).clip
    for ends in ("Hip", "Shoulder"):
        yaw = np.unwrap(_yaw_of(clip.positions, take.skeleton, ends))
        turned = np.abs(np.diff(yaw) / np.diff(clip.time))  # frames were dropped
        assert turned[part[1:]].max() < np.radians(450.0)
