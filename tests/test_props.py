"""Props along the script: the ball is dribbled, the box follows the hands."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from posed_people import posed
from skeletons import every_skeleton

from kinefilter.characters import KINECT_V1, Skeleton, standard_body
from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.humanoid import from_mujoco
from kinefilter.characters.rotations import rotate
from kinefilter.scenes import SCENES, load_scene
from kinefilter.scenes.library import movable_props, perform, prop_poses
from kinefilter.scenes.library.ball import Contact, Ending, ball_path, contacts
from kinefilter.scenes.library.moving_props import box_path
from kinefilter.scenes.library.performer_hands import Hands

Array = NDArray[np.float64]
FPS = 30.0
RADIUS = 0.121
PALM = 0.03
SIDES = ("Left", "Right")
SIZE = np.array([0.15, 0.2, 0.15])
BODY = standard_body(KINECT_V1)


def _hands(left: Array, right: Array, fps: float = FPS) -> Hands:
    """Return hands of somebody at the origin, the forearms forward, (T, 3) each."""
    positions = np.stack([left, right], axis=1)
    count = len(positions)
    return Hands(
        time=np.arange(count) / fps,
        positions=positions,
        elbows=positions - np.array([0.25, 0.0, 0.0]),
        root=np.tile([0.0, 0.0, 0.9], (count, 1)),
        head=np.full(count, 1.65),
        forward=np.tile([1.0, 0.0, 0.0], (count, 1)),
        radius=PALM,
    )


def _through(time: Array, keys: list[tuple[float, tuple[float, ...]]]) -> Array:
    """Interpolate key points smoothly, shape (T, 3)."""
    stamps = np.array([stamp for stamp, _ in keys])
    points = np.array([point for _, point in keys])
    k = np.clip(np.searchsorted(stamps, time, side="right") - 1, 0, len(keys) - 2)
    share = np.clip((time - stamps[k]) / (stamps[k + 1] - stamps[k]), 0.0, 1.0)
    ease = (share * share * (3.0 - 2.0 * share))[:, None]
    return np.asarray(points[k] + ease * (points[k + 1] - points[k]))


# Ball ---------------------------------------------------------------------------


def _dribbling(fps: float = FPS) -> Hands:
    """Hold the ball for a second, dribble five times with the right, hold it again."""
    time = np.arange(0.0, 5.5, 1.0 / fps)
    right = [(0.0, (0.35, -0.14, 1.1)), (0.7, (0.35, -0.14, 1.1))]
    left = [(0.0, (0.35, 0.14, 1.1)), (0.7, (0.35, 0.14, 1.1))]
    for beat in range(5):
        right.append((1.0 + 0.6 * beat, (0.35, -0.3, 0.98)))
        right.append((1.3 + 0.6 * beat, (0.33, -0.3, 0.74)))
    left += [(1.0, (0.3, 0.4, 1.0)), (3.9, (0.3, 0.4, 1.0))]
    for keys, side in ((right, -1.0), (left, 1.0)):
        keys += [(4.4, (0.35, 0.14 * side, 1.1)), (5.5, (0.35, 0.14 * side, 1.1))]
    return _hands(_through(time, left), _through(time, right), fps)


def _flights(touches: list[Contact]) -> list[slice]:
    return [slice(a.end, b.start + 1) for a, b in pairwise(touches)]


def test_a_dribbled_ball_bounces_once_between_touches() -> None:
    hands = _dribbling(120.0)
    path = ball_path(hands, RADIUS, np.zeros(3))
    touches = contacts(hands, RADIUS)
    assert [touch.ending for touch in touches[:-1]] == [Ending.STROKE] * 5
    for flight in _flights(touches):
        height = path[flight, 2] - RADIUS
        assert height.min() < 0.06
        lows = (height[1:-1] < height[:-2]) & (height[1:-1] <= height[2:])
        assert lows.sum() == 1


def test_a_flying_ball_falls_with_gravity_and_flies_straight() -> None:
    fps = 120.0
    hands = _dribbling(fps)
    path = ball_path(hands, RADIUS, np.zeros(3))
    compared = 0
    for flight in _flights(contacts(hands, RADIUS)):
        part = path[flight]
        bounce = int(np.argmin(part[:, 2]))
        bend = np.diff(part, n=2, axis=0) * fps**2
        np.testing.assert_allclose(bend[:, :2], 0.0, atol=1e-6)
        air = np.ones(len(bend), dtype=bool)
        air[max(bounce - 2, 0) : bounce + 1] = False
        np.testing.assert_allclose(bend[air, 2], -GRAVITY, atol=1e-6)
        compared += int(air.sum())
    assert compared > 50


def test_the_dribbling_hand_is_on_the_ball_while_it_has_it() -> None:
    hands = _dribbling()
    path = ball_path(hands, RADIUS, np.zeros(3))
    for touch in contacts(hands, RADIUS)[1:-1]:
        span = slice(touch.start, touch.end + 1)
        above = hands.positions[span, 1] - path[span]
        np.testing.assert_allclose(above[:, :2], 0.0, atol=1e-9)
        np.testing.assert_allclose(above[:, 2], RADIUS + PALM, atol=1e-9)


def test_a_held_ball_touches_both_palms() -> None:
    hands = _dribbling()
    path = ball_path(hands, RADIUS, np.zeros(3))
    for frame in (0, 10, len(path) - 1):
        away = np.linalg.norm(hands.positions[frame] - path[frame], axis=-1)
        np.testing.assert_allclose(away, RADIUS + PALM, atol=1e-6)


def test_the_ball_never_jumps_and_never_enters_the_floor() -> None:
    hands = _dribbling()
    path = ball_path(hands, RADIUS, np.zeros(3))
    assert path[:, 2].min() >= RADIUS - 1e-12
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() * FPS < 8.0


def test_a_thrown_ball_rises_over_the_hands_and_comes_down() -> None:
    time = np.arange(0.0, 4.0, 1.0 / FPS)
    keys = [(0.0, 1.0), (0.8, 1.0), (1.3, 2.0), (1.8, 2.0), (2.6, 0.8), (4.0, 0.8)]
    spread = [(t, 0.14 if t < 2.0 else 0.4) for t, _ in keys]
    left, right = (
        _through(
            time,
            [
                (t, (0.3, side * w, z))
                for (t, z), (_, w) in zip(keys, spread, strict=True)
            ],
        )
        for side in (1.0, -1.0)
    )
    hands = _hands(left, right)
    (touch,) = contacts(hands, RADIUS)
    assert touch.ending is Ending.THROW
    path = ball_path(hands, RADIUS, np.zeros(3))
    assert path[:, 2].max() > 2.0 + RADIUS
    assert path[touch.end :, 2].min() < RADIUS + 0.15
    free = path[touch.end : touch.end + 12, 2]
    np.testing.assert_allclose(np.diff(free, n=2) * FPS**2, -GRAVITY, atol=1e-6)


def test_a_ball_on_the_floor_waits_until_both_hands_take_it() -> None:
    time = np.arange(0.0, 3.0, 1.0 / FPS)
    hold = [(1.0, 0.14), (3.0, 0.14)]
    left, right = (
        _through(
            time,
            [
                (0.0, (0.1, side * 0.4, 0.8)),
                *((t, (0.4, side * w, 0.13 if t < 2 else 1.0)) for t, w in hold),
            ],
        )
        for side in (1.0, -1.0)
    )
    path = ball_path(_hands(left, right), RADIUS, np.zeros(3))
    waits = path[:20]
    np.testing.assert_allclose(waits, np.tile(waits[0], (20, 1)))
    assert waits[0, 2] == pytest.approx(RADIUS)
    assert path[-1, 2] == pytest.approx(1.0, abs=0.01)


def test_a_ball_that_nobody_touches_stays() -> None:
    time = np.arange(0.0, 2.0, 1.0 / FPS)
    left, right = (np.tile([0.1, side, 0.8], (len(time), 1)) for side in (0.3, -0.3))
    rest = np.array([0.4, -0.3, RADIUS])
    path = ball_path(_hands(left, right), RADIUS, rest)
    np.testing.assert_array_equal(path, np.tile(rest, (len(time), 1)))


# Box ----------------------------------------------------------------------------

REST = np.array([0.45, 0.0, 0.15, 1.0, 0.0, 0.0, 0.0])
PARTED, GRIPPED = 0.45, 0.22


def _lifting(low: float = 0.2, down: float = 0.2, turn: float = 0.0) -> Hands:
    """Grip a box at 1 s, hold it high from 2 to 3 s, let go at 4 s; heights [m]."""
    time = np.arange(0.0, 5.0, 1.0 / FPS)
    keys = [
        (0.0, 0.10, PARTED, 0.8),
        (0.9, 0.40, 0.35, low),
        (1.0, 0.40, GRIPPED, low),
        (2.0, 0.35, GRIPPED, 1.1),
        (3.0, 0.35, GRIPPED, 1.1),
        (4.0, 0.45, GRIPPED, down),
        (4.1, 0.45, 0.35, down),
        (5.0, 0.10, PARTED, 0.8),
    ]
    c, s = np.cos(turn), np.sin(turn)
    left, right = (
        _through(
            time,
            [(t, (c * x - s * k * w, s * x + c * k * w, z)) for t, x, w, z in keys],
        )
        for k in (1.0, -1.0)
    )
    hands = _hands(left, right)
    hands.forward[:] = [c, s, 0.0]
    return hands


def _floor(_: Array) -> float:
    return 0.0


def test_a_lifted_box_is_halfway_between_the_hands_and_turned_as_they_are() -> None:
    for turn in (0.0, 0.7, -2.0):
        hands = _lifting(turn=turn)
        path = box_path(hands, SIZE, REST, _floor)
        high = slice(round(2.1 * FPS), round(2.9 * FPS))
        np.testing.assert_allclose(path[high, :3], hands.middle[high], atol=1e-9)
        line = hands.positions[high, 0] - hands.positions[high, 1]
        line /= np.linalg.norm(line, axis=-1, keepdims=True)
        left = rotate(path[high, 3:], np.array([0.0, 1.0, 0.0]))
        np.testing.assert_allclose(left, line, atol=1e-9)


def test_the_box_lies_still_on_the_floor_before_and_after() -> None:
    path = box_path(_lifting(), SIZE, REST, _floor)
    for still in (path[: round(0.9 * FPS)], path[round(4.1 * FPS) :]):
        np.testing.assert_allclose(still, np.tile(still[0], (len(still), 1)))
        assert still[0, 2] == pytest.approx(SIZE[2])
        up = rotate(still[0, 3:], np.array([0.0, 0.0, 1.0]))
        np.testing.assert_allclose(up, [0.0, 0.0, 1.0], atol=1e-9)
    assert path[0, 0] == pytest.approx(0.4, abs=0.01)
    assert path[-1, 0] == pytest.approx(0.45, abs=0.01)


def test_no_corner_of_the_box_ever_enters_the_floor() -> None:
    corners = SIZE * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    hands = _lifting(low=0.05, down=0.1)
    hands.positions[:, 0, 2] += 0.1 * np.sin(3.0 * hands.time)  # tilts it
    path = box_path(hands, SIZE, REST, _floor)
    lowest = path[:, None, :3] + rotate(path[:, None, 3:], corners)
    assert lowest[..., 2].min() > -1e-9


def test_the_box_never_jumps() -> None:
    path = box_path(_lifting(), SIZE, REST, _floor)
    assert np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1).max() * FPS < 2.5
    np.testing.assert_allclose(np.linalg.norm(path[:, 3:], axis=1), 1.0)


def test_a_box_let_go_in_the_air_falls_freely() -> None:
    path = box_path(_lifting(down=1.0), SIZE, REST, _floor)
    drop = int(np.flatnonzero(np.diff(path[:, 2]) < -0.02)[0])
    fall = path[drop : drop + 10, 2]
    fall = fall[fall > SIZE[2] + 1e-9][1:]
    assert len(fall) > 5
    np.testing.assert_allclose(np.diff(fall, n=2) * FPS**2, -GRAVITY, atol=1e-6)
    assert path[-1, 2] == pytest.approx(SIZE[2])


def test_a_box_is_set_down_on_what_is_under_it() -> None:
    def table(point: Array) -> float:
        return 0.45 if point[0] > 0.42 else 0.0

    path = box_path(_lifting(down=0.65), SIZE, REST, table)
    assert path[0, 2] == pytest.approx(SIZE[2])
    assert path[-1, 2] == pytest.approx(0.45 + SIZE[2])


def test_a_box_first_taken_in_the_air_was_in_the_hands() -> None:
    hands = _lifting(low=0.9)
    path = box_path(hands, SIZE, REST, _floor)
    early = slice(round(0.4 * FPS), round(1.0 * FPS))
    np.testing.assert_allclose(path[early, :3], hands.middle[early], atol=1e-9)


def test_hands_that_hang_hold_no_box() -> None:
    time = np.arange(0.0, 2.0, 1.0 / FPS)
    left, right = (np.tile([0.1, side, 0.8], (len(time), 1)) for side in (0.25, -0.25))
    path = box_path(_hands(left, right), SIZE, REST, _floor)
    np.testing.assert_array_equal(path, np.tile(REST, (len(time), 1)))


# In scenes ----------------------------------------------------------------------


@pytest.mark.parametrize("scene", SCENES)
def test_every_movable_prop_has_a_pose_in_every_frame(scene: str) -> None:
    act = perform("wave", BODY, seed=0)
    spec = load_scene(scene)
    poses = prop_poses(spec, act)
    assert tuple(poses) == movable_props(spec)
    model = spec.compile()
    for name, path in poses.items():
        assert path.shape == (len(act), 7)
        np.testing.assert_allclose(np.linalg.norm(path[:, 3:], axis=1), 1.0)
        if name not in ("box", "ball"):
            rest = np.concatenate([model.body(name).pos, model.body(name).quat])
            np.testing.assert_array_equal(path, np.tile(rest, (len(act), 1)))


@pytest.mark.parametrize("motion", ["bend", "pick_up", "punch", "squat"])
def test_no_prop_enters_the_floor_whatever_is_performed(motion: str) -> None:
    act = perform(motion, BODY, seed=2)
    ball = prop_poses(load_scene("basketball"), act)["ball"]
    box = prop_poses(load_scene("box"), act)["box"]
    assert ball[:, 2].min() >= RADIUS - 1e-12
    assert box[:, 2].min() >= SIZE[2] - 1e-12


@pytest.mark.parametrize("frames", [1, 2])
def test_the_shortest_performances_have_poses_too(frames: int) -> None:
    act = perform("pick_up", BODY, seed=2)
    short = act.at(slice(frames))
    for scene in ("basketball", "box"):
        for path in prop_poses(load_scene(scene), short).values():
            assert path.shape == (frames, 7)
            assert np.all(np.isfinite(path))


@every_skeleton
def test_a_box_picked_up_by_a_performer_leaves_the_floor_and_comes_back(
    skeleton: Skeleton,
) -> None:
    act = perform("pick_up", standard_body(skeleton), seed=3)
    path = prop_poses(load_scene("box"), act)["box"]
    assert path[0, 2] == pytest.approx(0.15)
    assert path[:, 2].max() > 0.7
    assert path[-1, 2] == pytest.approx(0.15)
    hands = Hands.of(act)
    high = path[:, 2] > 0.7
    away = np.linalg.norm(path[high, :3] - hands.middle[high], axis=1)
    assert np.median(away) < 1e-9


def test_the_table_of_the_box_scene_carries_the_box() -> None:
    turn = -np.arctan2(0.95, 0.5)  # towards the table
    spec = load_scene("box")
    table = spec.body("table")
    time = _lifting().time
    far, high = np.linalg.norm(table.pos[:2]), [0.2, 0.2, 1.1, 0.62, 0.62]
    ways = [0.65 * far, 0.65 * far, 0.65 * far, far, far]
    keys = [
        (t, tuple(x * table.pos / far * [1.0, 1.0, 0.0] + [0.0, 0.0, z]))
        for t, x, z in zip((0.0, 1.1, 2.0, 3.0, 5.0), ways, high, strict=True)
    ]
    # Arms that point forward hold the box, and those of a T-pose do not.
    forward = {"ElbowLeft": (0.0, 0.0, 1.0), "ElbowRight": (0.0, 0.0, 1.0)}
    holding, parted = (posed(len(time), yaw=turn, **arms) for arms in (forward, {}))
    holds = time[:, None, None] < 4.0
    act = replace(
        holding, rotations=np.where(holds, holding.rotations, parted.rotations)
    )
    middle = act.positions[:, [KINECT_V1.index(f"Hand{s}") for s in SIDES]].mean(axis=1)
    root = act.root + from_mujoco(_through(time, keys)) - middle
    act = replace(act, time=time, root=root)
    path = prop_poses(spec, act)["box"]
    assert path[-1, 2] == pytest.approx(0.45 + 0.15)
    np.testing.assert_allclose(path[-1, :2], table.pos[:2], atol=0.02)
