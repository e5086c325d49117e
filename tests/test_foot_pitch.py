"""How steeply feet point, as their legs move."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from known_motions import BODY, Array, performed, stamps, standing
from real_data import CMU, captured
from skeletons import every_skeleton

from kinefilter.characters import KINECT_V1, KINECT_V2, Skeleton, standard_body
from kinefilter.characters.rotations import about_y, rotate
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats.npz import write_arrays
from kinefilter.pipeline.lab import foot_lessons
from kinefilter.pipeline.lab.foot_lessons import errors, learn, read_lessons
from kinefilter.pipeline.target import foot_pitch
from kinefilter.pipeline.target.feet import ankles_and_toes
from kinefilter.pipeline.target.foot_pitch import (
    FootPitch,
    PitchTracker,
    foot_pitches,
    legs_of,
    pitch_of,
)
from kinefilter.pipeline.target.target_stages import Feet
from kinefilter.pipeline.workers import workers
from kinefilter.scenes.library import perform

HIDDEN, SHOWN = 0.0, 1.0


def pitches(path: Array, shown: float, stands: bool, skeleton: Skeleton) -> Array:
    level, flags = np.full((len(path), 2), shown), np.full((len(path), 2), stands)
    body = standard_body(skeleton)
    return foot_pitches(stamps(len(path)), path, level, flags, body)


def walk(skeleton: Skeleton) -> Array:
    return perform("walk", standard_body(skeleton), seed=1).positions


@every_skeleton
def test_who_stands_at_ease_has_flat_feet(skeleton: Skeleton) -> None:
    for shown in (HIDDEN, SHOWN):
        found = pitches(standing(40, skeleton), shown, True, skeleton)
        np.testing.assert_allclose(found, 0.0, atol=1e-9)


@every_skeleton
def test_feet_of_whoever_walks_point_down_and_up_whatever_their_toes_do(
    skeleton: Skeleton,
) -> None:
    path = walk(skeleton).copy()
    found = pitches(path, HIDDEN, False, skeleton)
    assert np.percentile(found, 2.0) < np.radians(-30.0)
    assert np.percentile(found, 98.0) > np.radians(5.0)
    assert np.abs(np.median(found)) < np.radians(8.0)
    path[:, ankles_and_toes(skeleton)[1]] += [0.1, 0.1, 0.0]
    np.testing.assert_allclose(pitches(path, HIDDEN, False, skeleton), found, atol=0.3)
    assert not np.allclose(pitches(path, SHOWN, False, skeleton), found, atol=0.3)


def test_toes_that_are_shown_decide_but_planted_feet_are_flat_within_errors() -> None:
    path = walk(KINECT_V2)
    shown = pitch_of(path, standard_body(KINECT_V2))
    np.testing.assert_allclose(pitches(path, SHOWN, False, KINECT_V2), shown)
    planted = pitches(path, SHOWN, True, KINECT_V2)
    assert not planted[np.abs(shown) < np.radians(5.0)].any()
    steep = np.abs(shown) > np.radians(15.0)
    assert steep.any()
    np.testing.assert_allclose(planted[steep], shown[steep])
    assert (np.abs(planted) <= np.abs(shown) + 1e-12).all()


def test_live_feet_point_as_in_whole_takes() -> None:
    path, rng = walk(KINECT_V2), np.random.default_rng(0)
    stands = rng.random((len(path), 2)) < 0.5
    shown = rng.random((len(path), 2))
    time, body = stamps(len(path)), standard_body(KINECT_V2)
    tracker = PitchTracker(body)
    live = [
        tracker.step(*frame) for frame in zip(time, path, shown, stands, strict=True)
    ]
    whole = foot_pitches(time, path, shown, stands, body)
    np.testing.assert_allclose(live, whole, atol=1e-5)


@pytest.mark.parametrize("yaw", [0.7, -2.5])
def test_pitches_turn_with_the_body_and_mirror_images_have_the_same(yaw: float) -> None:
    path, mirror = walk(KINECT_V2), KINECT_V2.mirror
    found = pitches(path, HIDDEN, False, KINECT_V2)
    turned = rotate(about_y(yaw), path) + np.array([1.0, 0.0, -3.0])
    np.testing.assert_allclose(
        pitches(turned, HIDDEN, False, KINECT_V2), found, atol=1e-5
    )
    mirrored = path[:, mirror] * [-1.0, 1.0, 1.0]
    np.testing.assert_allclose(
        pitches(mirrored, HIDDEN, False, KINECT_V2), found[:, ::-1], atol=1e-5
    )


def test_legs_that_move_as_nobody_did_leave_feet_as_they_are() -> None:
    path = standing(40)[..., [0, 2, 1]] * [1.0, 1.0, -1.0] + [0.0, 0.1, 0.0]  # lying
    time = stamps(40)
    inputs = foot_pitch.described(time, legs_of(path, KINECT_V1), time)
    assert not foot_pitch.foot_pitch()(inputs)[1].any()
    up = pitch_of(path, BODY)
    assert up.min() > np.radians(60.0)
    np.testing.assert_allclose(pitches(path, HIDDEN, False, KINECT_V1), up)
    assert not pitches(path, HIDDEN, True, KINECT_V1).any()


@pytest.mark.parametrize("part", [0, 1])
def test_heels_and_toes_that_are_said_to_be_down_are(part: int) -> None:
    take = performed("walk", KINECT_V2)
    given = np.ones((len(take.time), 4), dtype=np.bool_)
    given[:, 1 - part :: 2] = False  # of the other part nothing is said
    config = CleanConfig(method="none")
    draft = Cleaner(config).replaced(Feet(config, given)).until("feet").whole(take)
    assert draft.contacts[:, part::2].all()
    pitch = pitch_of(draft.positions, draft.body)
    assert np.abs(pitch).max() > np.radians(10.0)
    assert ((1.0, -1.0)[part] * pitch).min() > -np.radians(0.5)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), frames=st.integers(1, 40))
def test_any_motion_has_possible_pitches(seed: int, frames: int) -> None:
    rng = np.random.default_rng(seed)
    path = standing(frames) + rng.normal(0.0, 0.3, (frames, 20, 3))
    stands, shown = rng.random((2, frames, 2))
    found = foot_pitches(stamps(frames), path, shown, stands < 0.5, BODY)
    flat = foot_pitch.flat_angle(BODY)
    assert np.abs(found - flat).max() <= 0.5 * np.pi + 1e-9


@captured
def test_what_is_learned_from_some_people_holds_for_others(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(foot_lessons, "workers", partial(workers, 1))
    walks = ["02_01", "07_01", "08_01", "12_01", "16_15", "16_31", "26_01", "29_01"]
    files = [CMU / f"{name}.bvh.gz" for name in (*walks, "32_01", "35_01")]
    lessons = read_lessons(files)
    people = [one.person for one in lessons]
    assert people == ["02", "07", "08", "12", "16", "26", "29", "32", "35"]
    other = lessons.pop(1)
    predict = learn(lessons)
    flat, shown, predicted = errors(predict, other)
    assert predicted < 0.75 * min(flat, shown)
    write_arrays(tmp_path / "weights.npz", predict.arrays())
    again = FootPitch.load(tmp_path / "weights.npz")
    assert errors(again, other)[2] == pytest.approx(predicted, abs=0.05)
    assert errors(foot_pitch.foot_pitch(), other)[2] < predicted
