"""The scripted motions as a whole: human ranges, planted feet, no part in another."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, KINECT_V2, Motion, standard_body
from kinefilter.characters.rotations import about_x, about_z, inverse, multiply, rotate
from kinefilter.scenes.library import MOTIONS, Area, perform, random_body
from kinefilter.scenes.library.poses import JOINT_RANGES

Array = NDArray[np.float64]
PEOPLE = range(2)
SLACK = 5.0  # deg: sway, and the shoulder's range is measured with the collarbone's
SIDES = (("Left", 1.0), ("Right", -1.0))
FLIGHT = {"jump", "run"}
TISSUE, HANDS = 0.05, 0.06  # m that parts may overlap; hands also touch and hold

every_motion = pytest.mark.parametrize("name", MOTIONS)
index = KINECT_V1.index
AREAS = {
    "wide": Area((-1.8, 1.8), (-1.5, 0.7)),
    "narrow": Area((-1.3, 1.3), (-1.0, 0.0)),
}
every_area = pytest.mark.parametrize("area", AREAS.values(), ids=AREAS)
every_gait = pytest.mark.parametrize("name", ["carry", "march", "run", "walk"])


@cache
def performance(name: str, person: int, within: Area | None = None) -> Motion:
    """The performance of a person of their own height and build."""
    body = random_body(KINECT_V1, np.random.default_rng(100 + person))
    return perform(name, body, seed=person, within=within)


def performances(name: str, within: Area | None = None) -> list[Motion]:
    return [performance(name, person, within) for person in PEOPLE]


# Joint ranges


def tilts(turns: Array) -> tuple[Array, Array, Array]:
    """Flexion, bend to the left and rotation to the left [rad] of rotations."""
    up = rotate(turns, np.array([0.0, 1.0, 0.0]))
    flexion, bend = np.arctan2(up[..., 2], up[..., 1]), np.arcsin(up[..., 0])
    rest = multiply(inverse(multiply(about_x(flexion), about_z(-bend))), turns)
    left = rotate(rest, np.array([1.0, 0.0, 0.0]))
    return flexion, bend, np.arctan2(-left[..., 2], left[..., 0])


def bone(p: Motion, start: str, end: str) -> Array:
    line = p.positions[:, index(end)] - p.positions[:, index(start)]
    return np.asarray(line / np.linalg.norm(line, axis=-1, keepdims=True))


def joint_angles(p: Motion) -> dict[str, Array]:
    """Every angle of JOINT_RANGES [deg], of both sides one after the other."""
    pelvis, thorax = (p.rotations[:, index(j)] for j in ("HipCenter", "ShoulderCenter"))
    found: dict[str, list[Array]] = {name: [] for name in JOINT_RANGES}
    head = multiply(inverse(thorax), p.rotations[:, index("Head")])
    for part, turns in (
        ("trunk", multiply(inverse(pelvis), thorax)),
        ("neck", head),
    ):
        for way, angle in zip(
            ("flexion", "bend", "rotation"), tilts(turns), strict=True
        ):
            found[f"{part} {way}"].append(angle)
    for side, out in SIDES:
        upper = bone(p, f"Shoulder{side}", f"Elbow{side}")
        fore = bone(p, f"Elbow{side}", f"Wrist{side}")
        thigh, shank = (
            bone(p, f"{a}{side}", f"{b}{side}")
            for a, b in (("Hip", "Knee"), ("Knee", "Ankle"))
        )
        arm, leg = rotate(inverse(thorax), upper), rotate(inverse(pelvis), thigh)
        back = np.arctan2(-arm[:, 2], np.hypot(arm[:, 0], arm[:, 1]))
        found["shoulder elevation"].append(np.arccos(-arm[:, 1]))
        found["shoulder extension"].append(back)
        found["hip flexion"].append(np.arctan2(leg[:, 2], -leg[:, 1]))
        found["hip abduction"].append(np.arcsin(out * leg[:, 0]))
        found["elbow flexion"].append(np.arccos(np.sum(upper * fore, axis=1)))
        found["knee flexion"].append(np.arccos(np.sum(thigh * shank, axis=1)))
    return {name: np.degrees(np.concatenate(parts)) for name, parts in found.items()}


@every_motion
def test_joints_stay_within_human_ranges(name: str) -> None:
    for p in performances(name):
        angles = joint_angles(p)
        for joint, (least, most) in JOINT_RANGES.items():
            assert angles[joint].min() > least - SLACK, joint
            assert angles[joint].max() < most + SLACK, joint


@every_motion
def test_speed_and_acceleration_are_human(name: str) -> None:
    for p in performances(name):
        speed = np.linalg.norm(np.diff(p.positions, axis=0), axis=-1) * 30.0
        change = np.linalg.norm(np.diff(p.positions, 2, axis=0), axis=-1) * 900.0
        assert 0.05 < speed.max() < 12.0
        assert change.max() < 150.0


# Floor


def heights(p: Motion) -> Array:
    """Lowest height [m] of the body's capsules in each frame, (T,)."""
    low = p.positions[..., 1] - p.body.radii
    parts = [low]
    for j, parent in zip(KINECT_V1.segments, KINECT_V1.segment_parents, strict=True):
        parts.append(p.positions[:, [parent], 1] - p.body.radii[j])
    return np.asarray(np.concatenate(parts, axis=1).min(axis=1))


@every_motion
def test_the_lowest_point_is_on_the_floor(name: str) -> None:
    for p in performances(name):
        low = heights(p)
        assert low.min() > -0.01
        if name not in FLIGHT:
            assert low.max() < 0.01


@every_motion
def test_a_foot_that_stands_stays_where_it_is(name: str) -> None:
    assert_feet_stay(performances(name))


def assert_feet_stay(acts: list[Motion]) -> None:
    stood = 0
    for p, (side, _) in product(acts, SIDES):
        toes = p.positions[:, index(f"Foot{side}")]
        down = toes[:, 1] - p.body.radii[index(f"Foot{side}")] < 1e-3
        edges = np.flatnonzero(np.diff(np.pad(down.astype(int), 1)))
        for start, stop in edges.reshape(-1, 2):
            # Two frames each for landing and leaving.
            track = toes[start + 2 : max(stop - 2, 0), [0, 2]]
            if len(track) > 1:
                stood += len(track)
                assert np.ptp(track, axis=0).max() < 0.005, side
    assert stood > 30


# Self-penetration


def gap(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Distance [m] between the segments a-b and c-d, (T,)."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv, uw, vw = (
        np.sum(x * y, axis=-1) for x, y in ((u, u), (u, v), (v, v), (u, w), (v, w))
    )
    s = np.clip((uv * vw - vv * uw) / np.maximum(uu * vv - uv * uv, 1e-9), 0.0, 1.0)
    t = np.clip((uv * s + vw) / vv, 0.0, 1.0)
    s = np.clip((uv * t - uw) / uu, 0.0, 1.0)
    return np.asarray(np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=-1))


def overlap(p: Motion, first: str, second: str) -> Array:
    """How deep [m] the capsules of two segments are in each other, (T,)."""
    ends = [index(first), index(second)]
    starts = [KINECT_V1.parents[j] for j in ends]
    (a, c), (b, d) = (
        (p.positions[:, row[0]], p.positions[:, row[1]]) for row in (starts, ends)
    )
    if first.startswith("Knee") and second.startswith("Knee"):
        # Thighs meet at the groin; a third of the way down they no longer do.
        a, c = a + (b - a) / 3.0, c + (d - c) / 3.0
    return np.asarray(p.body.radii[ends].sum() - gap(a, b, c, d))


TRUNK = ("Spine", "ShoulderCenter", "Head")
LEGS = [f"{part}{side}" for part in ("Knee", "Ankle") for side, _ in SIDES]


@every_motion
def test_arms_do_not_pass_through_trunk_head_and_legs(name: str) -> None:
    for p in performances(name):
        for part, (side, _) in product(("Wrist", "Hand"), SIDES):
            for other in (*TRUNK, *LEGS):
                deep = overlap(p, part + side, other).max()
                assert deep < TISSUE, (part + side, other)


@every_motion
def test_arms_do_not_pass_through_each_other(name: str) -> None:
    for p in performances(name):
        for first, second in product(("Elbow", "Wrist", "Hand"), repeat=2):
            if (first, second) != ("Elbow", "Elbow"):
                assert overlap(p, f"{first}Left", f"{second}Right").max() < HANDS


@every_motion
def test_legs_do_not_pass_through_each_other(name: str) -> None:
    assert_legs_are_apart(performances(name))


def assert_legs_are_apart(acts: list[Motion]) -> None:
    for p in acts:
        for first, second in (
            ("KneeLeft", "KneeRight"),
            ("AnkleLeft", "AnkleRight"),
            ("FootLeft", "FootRight"),
            ("AnkleLeft", "KneeRight"),
            ("KneeLeft", "AnkleRight"),
        ):
            assert overlap(p, first, second).max() < TISSUE, (first, second)


# Gaits that go around


@every_area
@every_gait
def test_within_an_area_gaits_go_around_on_feet_that_stay(
    name: str, area: Area
) -> None:
    acts = performances(name, area)
    assert_feet_stay(acts)
    assert_legs_are_apart(acts)
    for p in acts:
        for k, (least, most) in zip((0, 2), area, strict=True):
            assert p.root[:, k].min() > least - 0.06
            assert p.root[:, k].max() < most + 0.06
        assert heights(p).min() > -0.01
        change = np.linalg.norm(np.diff(p.positions, 2, axis=0), axis=-1) * 900.0
        assert change.max() < 150.0


@every_area
@pytest.mark.parametrize("name", ["carry", "run", "walk"])
def test_who_goes_around_faces_where_they_go_and_does_not_spin(
    name: str, area: Area
) -> None:
    for p in performances(name, area):
        ahead = rotate(p.rotations[:, KINECT_V1.root], np.array([0.0, 0.0, 1.0]))
        steps = np.gradient(p.root, axis=0)
        cosine = np.sum((ahead * steps)[:, [0, 2]], axis=1)
        cosine /= np.linalg.norm(ahead[:, [0, 2]], axis=1)
        cosine /= np.linalg.norm(steps[:, [0, 2]], axis=1)
        assert np.median(cosine) > 0.9
        heading = np.unwrap(np.arctan2(ahead[:, 0], ahead[:, 2]))
        turned = np.abs(heading[30:] - heading[:-30])
        assert turned.max() < np.pi
        assert np.abs(heading[-1] - heading[0]) > np.pi / 2.0


@pytest.mark.parametrize("name", ["wave", "turn"])
def test_an_area_changes_nothing_of_motions_that_stay(name: str) -> None:
    free, held = performance(name, 0), performance(name, 0, AREAS["narrow"])
    np.testing.assert_array_equal(free.rotations, held.rotations)
    np.testing.assert_array_equal(free.root, held.root)


# Size of the library


def test_the_library_has_the_classes_of_the_papers_the_data_and_the_scenes() -> None:
    assert len(MOTIONS) >= 25
    shum = {"walk", "run", "pick_up", "carry", "point", "scratch", "punch", "kick"}
    shum |= {"swing", "dodge"}
    liu = {"tai_chi", "bend", "golf_swing", "cross_arms", "wave", "clap", "roll_hands"}
    liu |= {"bend_leg", "turn"}
    rehabilitation = {"deep_squat", "hurdle_step", "inline_lunge", "side_lunge"}
    rehabilitation |= {"sit_to_stand", "leg_raise"}
    rehabilitation |= {
        f"shoulder_{way}" for way in ("abduction", "extension", "rotation", "scaption")
    }
    chiang = {"deep_breathing", "clasp_and_spread", "overhead_pumping"}
    chiang |= {"push_down_pumping"}
    scenes = {"lift_box", "flip_chart", "basketball", "chair", "office"}
    assert shum | liu | rehabilitation | chiang | scenes <= set(MOTIONS)


@every_motion
def test_a_performance_lasts_five_seconds_at_least(name: str) -> None:
    for p in performances(name):
        assert p.time[-1] >= 4.9


@pytest.mark.parametrize("name", ["wave", "deep_squat"])
def test_the_frame_rate_does_not_change_the_motion(name: str) -> None:
    body = standard_body(KINECT_V1)
    slow = perform(name, body, seed=1, fps=30.0)
    fast = perform(name, body, seed=1, fps=60.0)
    frames = min(len(slow), (len(fast) + 1) // 2)
    apart = fast.positions[: 2 * frames : 2] - slow.positions[:frames]
    assert np.linalg.norm(apart, axis=-1).mean() < 0.005


def test_both_skeletons_share_the_random_body() -> None:
    one, two = (
        random_body(skeleton, np.random.default_rng(3))
        for skeleton in (KINECT_V1, KINECT_V2)
    )
    assert one.height == two.height
    for joint in ("KneeLeft", "WristRight", "ShoulderLeft", "HipRight"):
        lengths = one.lengths[index(joint)], two.lengths[KINECT_V2.index(joint)]
        assert lengths[0] == pytest.approx(lengths[1])


def test_random_bodies_differ_in_height_and_build_and_are_symmetric() -> None:
    bodies = [random_body(KINECT_V1, np.random.default_rng(k)) for k in range(200)]
    heights = np.array([body.height for body in bodies])
    assert 1.5 <= heights.min() < 1.6
    assert 1.8 < heights.max() <= 2.0
    shares = np.array([body.lengths / body.height for body in bodies])
    limbs = KINECT_V1.segments[shares[:, KINECT_V1.segments].std(axis=0) > 1e-6]
    spread = (shares.std(axis=0) / shares.mean(axis=0).clip(min=1e-9))[limbs]
    assert ((spread > 0.02) & (spread < 0.06)).all()
    np.testing.assert_allclose(shares, shares[:, KINECT_V1.mirror])
