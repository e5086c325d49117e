"""Live joints are smoothed by where they were, without lag in steady motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, State, Take, standard_body
from kinefilter.pipeline.lab import smoothing_lessons
from kinefilter.pipeline.lab.smoothing_lessons import (
    Example,
    example_of,
    fit,
    measures,
)
from kinefilter.pipeline.target.smooth import smooth_by_speed
from kinefilter.pipeline.target.smooth_live import MOVING, LiveSmoother

Array = NDArray[np.float64]
REST = standard_body(KINECT_V1).rest_positions
HAND = KINECT_V1.index("HandLeft")


def stamps(rate: float, seconds: float, seed: int = 0) -> Array:
    """Uneven time stamps [s], as sensors give them."""
    steps = np.random.default_rng(seed).uniform(0.8, 1.2, round(rate * seconds)) / rate
    return 100.0 + np.cumsum(steps)


def smoothed(
    positions: Array, time: Array, smoother: LiveSmoother | None = None
) -> Array:
    """The joints (T, J, 3), smoothed frame by frame."""
    smoother = smoother or LiveSmoother(KINECT_V1)
    frames = zip(positions, time.tolist(), strict=True)
    return np.array([smoother.step(*frame) for frame in frames])


@pytest.mark.parametrize("rate", [15.0, 30.0, 60.0])
@pytest.mark.parametrize("speed", [0.6, 3.0])
def test_steady_motion_has_no_lag_at_any_frame_rate(rate: float, speed: float) -> None:
    time = stamps(rate, 4.0)
    path = REST + np.outer(speed * time, [0.6, 0.0, 0.8])[:, None]
    away = smoothed(path, time)[time > time[0] + 2.5] - path[time > time[0] + 2.5]
    assert np.abs(away).max() < 1e-4 * speed


@pytest.mark.parametrize("rate", [15.0, 30.0, 60.0])
def test_whoever_stands_still_trembles_less_and_stays_in_place(rate: float) -> None:
    time = stamps(rate, 6.0)
    noise = np.random.default_rng(1).normal(scale=0.004, size=(len(time), *REST.shape))
    found = smoothed(REST + noise, time)
    assert np.abs((found - REST).mean(axis=0)).max() < 0.002
    assert (found - REST)[10:].std() < 0.75 * noise.std()
    leaps, raw = (
        np.abs(np.diff(joints, 3, axis=0)).mean() for joints in (found, noise)
    )
    assert leaps < 0.5 * raw


def test_smoothing_does_not_depend_on_heading_and_place() -> None:
    time, rng = stamps(30.0, 2.0), np.random.default_rng(2)
    path = REST + np.cumsum(
        rng.normal(scale=0.02, size=(len(time), *REST.shape)), axis=0
    )
    turn = np.array([[0.6, 0.0, -0.8], [0.0, 1.0, 0.0], [0.8, 0.0, 0.6]])
    turned = smoothed(path @ turn + [1.0, 2.0, 3.0], time)
    np.testing.assert_allclose(
        turned, smoothed(path, time) @ turn + [1, 2, 3], atol=1e-9
    )


def test_a_walking_trunk_is_smoothed_and_a_moving_hand_is_not_late() -> None:
    time = np.arange(150) / 30.0
    noise = np.random.default_rng(5).normal(scale=0.005, size=(150, *REST.shape))
    path = REST + np.outer(1.2 * time, [0.6, 0.0, 0.8])[:, None]
    others, alone = np.arange(len(KINECT_V1)) != HAND, path.copy()
    alone[:, others] = REST[others]
    leaps = []
    for joints in (path, alone):
        found = smoothed(joints + noise, time)[60:, HAND]
        leaps.append(np.abs(np.diff(found, 3, axis=0)).mean())
        assert np.abs((found - joints[60:, HAND]).mean(axis=0)).max() < 0.002
    assert leaps[0] < 0.8 * leaps[1]


@pytest.mark.parametrize("moved", [[HAND], slice(None)])
def test_what_is_suddenly_elsewhere_is_there_at_once(moved: Any) -> None:
    time = np.arange(60) / 30.0
    path = np.tile(REST, (60, 1, 1))
    path[20:, moved, 0] += 1.5
    np.testing.assert_allclose(smoothed(path, time), path, atol=1e-9)


def test_start_forgets_all_frames() -> None:
    time, rng = stamps(30.0, 1.0), np.random.default_rng(3)
    path, smoother = (
        REST + rng.normal(scale=0.1, size=(30, *REST.shape)),
        LiveSmoother(KINECT_V1),
    )
    first = smoothed(path, time, smoother)
    smoother.start()
    np.testing.assert_array_equal(smoothed(path, time, smoother), first)
    np.testing.assert_array_equal(first[0], path[0])


def test_lessons_learn_to_smooth_noise_without_lag() -> None:
    time, rng = np.arange(900) / 30.0, np.random.default_rng(4)
    waves = np.sin(2.0 * np.pi * 0.5 * time)[:, None, None] * rng.uniform(
        0, 0.3, (20, 3)
    )
    joints = REST + waves + rng.normal(scale=0.005, size=(900, 20, 3))
    smooth = smooth_by_speed(time, joints, np.ones((900, 20)), cutoff=6.0)
    state = np.full((900, 20), State.TRACKED, dtype=np.uint8)
    take = Take(time, joints, state, KINECT_V1, "waves")
    speed = np.linalg.norm(np.gradient(smooth, time, axis=0), axis=2)
    example = Example(take, joints, smooth, speed)
    moving = np.array(fit([example])["moving"])
    assert moving @ np.arange(1, 8) == pytest.approx(0.0, abs=2e-3)
    assert MOVING @ np.arange(1, 8) == pytest.approx(0.0, abs=2e-3)
    noise_left = np.square([1.0 - moving.sum(), *moving]).sum()
    assert noise_left < 0.65
    leaps, _, away, _ = measures(smooth, example)
    assert 0.0 < leaps < 8.0
    assert away == 0.0


def test_lessons_aim_at_where_clips_are_smoothed_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A joint that is off for one frame does not draw live joints toward it."""
    path, state = np.tile(REST, (60, 1, 1)), np.full((60, len(KINECT_V1)), 2, np.uint8)
    path[30, HAND, 0] += 0.3
    monkeypatch.setattr(smoothing_lessons, "followed", lambda *_: path)
    take = Take(np.arange(60) / 30.0, path, state, KINECT_V1, "thrown")
    assert np.abs(example_of(take).smooth - REST).max() < 0.01
