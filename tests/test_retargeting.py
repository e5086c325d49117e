"""Motions on other people's rigs: hands and feet in place, knees ahead, no slide."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rig_motions import ARM, LEG, SIDES, bent_to, performed

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import CONTACTS, KINECT_V1, KINECT_V2, Clip, standard_body
from kinefilter.characters.rotations import about_y, multiply, rotate, rotation_vector
from kinefilter.retarget.limbs import shortage
from kinefilter.retarget.retargeting import Retargeted, retarget
from kinefilter.retarget.rig_map import RIGS, load_rig_map
from kinefilter.retarget.target_rig import RestPose, TargetRig, built_rig, matched_rig

Array = NDArray[np.float64]
Limb = tuple[tuple[str, str, str], tuple[str, str, str]]
SAMPLE = Path(__file__).parents[1] / "scenes" / "takes" / "wave_punch_bend.csv"
REACH = 0.02  # m, of a limb as long as the person's
SLIDE = 0.003  # m a frame


def giant(name: str, clip: Clip) -> TargetRig:
    """Return a rig with legs half as long again, short forearms, that faces -x."""
    rig_map = load_rig_map(name)
    built = built_rig(rig_map, clip.body)
    part_of = {n: part for part, joints in built.parts.items() for n in joints}
    factors = {"shin": 1.6, "foot": 1.4, "hand": 0.7, "upper arm": 1.3, "toes": 1.8}
    rest = built.rest
    places = np.zeros_like(rest.positions)
    for n, parent in enumerate(rest.parents):
        if parent >= 0:
            factor = factors.get(part_of.get(n, "").partition(" ")[2], 1.1)
            bone = rest.positions[n] - rest.positions[parent]
            places[n] = places[parent] + factor * bone
    places = rotate(about_y(-np.pi / 2), places)
    return matched_rig(
        rig_map, replace(rest, positions=places), standard_body(clip.skeleton)
    )


def worst_reach(clip: Clip, rig: TargetRig, motion: Retargeted, limb: Limb) -> float:
    """Return by how much limbs end elsewhere relative to their length, at most [m].

    It is the vector from shoulder to wrist over the length of the arm, and from hip to
    ankle over that of the leg, for a limb as long as the person's.
    """
    parts, joints = limb
    away = []
    for side in SIDES:
        ours = [clip.skeleton.index(f"{j}{side.capitalize()}") for j in joints]
        wanted = clip.positions[:, ours[2]] - clip.positions[:, ours[0]]
        theirs = [rig.joint(f"{side} {part}") for part in (parts[0], parts[2])]
        vector = motion.positions[:, theirs[1]] - motion.positions[:, theirs[0]]
        scale = rig.limb(side, *parts).sum() / clip.body.lengths[ours[1:]].sum()
        away.append(np.linalg.norm(vector / scale - wanted, axis=-1).max())
    return float(max(away))


def slides(clip: Clip, rig: TargetRig, motion: Retargeted) -> Array:
    """Return how far heels and toes that stand move from frame to frame [m]."""
    found = []
    for column, name in enumerate(CONTACTS):
        side = "left" if name.endswith("Left") else "right"
        part = f"{side} {'foot' if name.startswith('Heel') else 'toes'}"
        stands = clip.contacts[1:, column] & clip.contacts[:-1, column]
        path = motion.positions[:, rig.joint(part)]
        found.append(np.linalg.norm(np.diff(path, axis=0), axis=-1)[stands])
    return np.concatenate(found)


def fold(limb: Array) -> Array:
    """Return a limb's fold [rad], (T,): short forearms fold less to reach as far."""
    line = limb[:, -1] - limb[:, 0]
    cosine = np.vecdot(upper_bone(limb), line) / np.linalg.norm(line, axis=-1)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


@pytest.fixture(scope="module")
def clips() -> dict[str, Clip]:
    """Return motions with and without steps, and the sample take, cleaned."""
    names = ("walk", "turn", "squat", "kick", "jump")
    made = {name: performed(name) for name in names}
    made["walk on Kinect v1"] = performed("walk", seed=5, skeleton=KINECT_V1)
    made["sample take"] = clean(read_take(SAMPLE), CleanConfig(physics=False)).clip
    return made


every_rig = pytest.mark.parametrize("name", RIGS)


every_body = pytest.mark.parametrize(
    "make", [lambda name, clip: built_rig(load_rig_map(name), clip.body), giant],
    ids=["own", "giant"],
)  # fmt: skip


Make = Callable[[str, Clip], TargetRig]


@every_rig
@every_body
def test_hands_and_feet_are_at_the_same_place_relative_to_limb_length(
    clips: dict[str, Clip], name: str, make: Make
) -> None:
    for clip in clips.values():
        rig = make(name, clip)
        motion = retarget(clip, rig)
        assert worst_reach(clip, rig, motion, ARM) < REACH
        assert worst_reach(clip, rig, motion, LEG) < REACH


@every_rig
@every_body
def test_feet_that_stand_do_not_slide(
    clips: dict[str, Clip], name: str, make: Make
) -> None:
    for title, clip in clips.items():
        rig = make(name, clip)
        slid = slides(clip, rig, retarget(clip, rig))
        assert len(slid) > 50, title
        assert slid.max() < SLIDE, title


@every_rig
@every_body
def test_toes_that_stand_are_on_the_floor_and_none_are_under_it(
    clips: dict[str, Clip], name: str, make: Make
) -> None:
    clip = clips["walk"]
    rig = make(name, clip)
    motion = retarget(clip, rig)
    for side in SIDES:
        toes = rig.joint(f"{side} toes")
        flat = rig.rest.positions[toes, 1] - rig.floor
        height = motion.positions[:, toes, 1]
        stands = clip.contacts[:, CONTACTS.index(f"Toe{side.capitalize()}")]
        assert np.abs(height[stands] - flat).max() < 1e-6
        assert height.min() > flat - 1e-6


@every_rig
@every_body
def test_every_bone_keeps_its_length(
    clips: dict[str, Clip], name: str, make: Make
) -> None:
    clip = clips["walk"]
    rig = make(name, clip)
    rest, motion = rig.rest, retarget(clip, rig)
    pelvis = rig.joint("pelvis")
    for n, parent in enumerate(rest.parents):
        if parent >= 0 and n != pelvis and n not in rig.followed:
            bone = motion.positions[:, n] - motion.positions[:, parent]
            length = np.linalg.norm(rest.positions[n] - rest.positions[parent])
            np.testing.assert_allclose(np.linalg.norm(bone, axis=-1), length)
            turned = rotate(
                motion.rotations[:, parent], rest.positions[n] - rest.positions[parent]
            )
            np.testing.assert_allclose(bone, turned, atol=1e-9)


@every_rig
@every_body
def test_upper_arms_and_thighs_point_where_the_persons_do(
    clips: dict[str, Clip], name: str, make: Make
) -> None:
    for clip in clips.values():
        rig = make(name, clip)
        motion = retarget(clip, rig)
        for parts, joints in (ARM, LEG):
            for side in SIDES:
                ours = [clip.skeleton.index(f"{j}{side.capitalize()}") for j in joints]
                theirs = [rig.joint(f"{side} {part}") for part in parts]
                limbs = clip.positions[:, ours], motion.positions[:, theirs]
                turned = np.vecdot(*map(upper_bone, limbs)).clip(-1.0, 1.0)
                away = np.arccos(turned) - np.abs(np.subtract(*map(fold, limbs)))
                assert np.degrees(away.max()) < 5.0


@every_rig
def test_arms_that_are_bent_point_where_the_persons_do(
    clips: dict[str, Clip], name: str
) -> None:
    """Legs do where their feet do not have to be held."""
    (parts, joints), looked_at = ARM, 0
    for title, clip in clips.items():
        rig = built_rig(load_rig_map(name), clip.body)
        motion = retarget(clip, rig)
        for side in SIDES:
            ours = [clip.skeleton.index(f"{j}{side.capitalize()}") for j in joints]
            theirs = [rig.joint(f"{side} {part}") for part in parts]
            arm = clip.positions[:, ours]
            bent = np.linalg.norm(bent_to(arm), axis=-1) > 0.04
            looked_at += bent.sum()
            for first in (0, 1):
                wanted, found = (
                    upper_bone(limb[bent, first:])
                    for limb in (arm, motion.positions[:, theirs])
                )
                away = np.linalg.norm(wanted - found, axis=-1)
                assert np.degrees(away.max(initial=0.0)) < 0.5, title
    assert looked_at > 300


@every_rig
def test_legs_of_the_persons_size_are_where_the_persons_are(
    clips: dict[str, Clip], name: str
) -> None:
    """But for knees of legs that are all but straight, which millimeters bend."""
    for title in ("walk", "squat", "walk on Kinect v1"):
        clip = clips[title]
        rig = built_rig(load_rig_map(name), clip.body)
        motion = retarget(clip, rig)
        for side in SIDES:
            for part, joint in (("thigh", "Hip"), ("foot", "Ankle")):
                ours = clip.skeleton.index(f"{joint}{side.capitalize()}")
                found = motion.positions[:, rig.joint(f"{side} {part}")]
                away = np.linalg.norm(found - clip.positions[:, ours], axis=-1)
                assert away.max() < 1e-3, title


def upper_bone(limb: Array) -> Array:
    """Return the direction of a limb's first bone (T, 3, 3), shape (T, 3)."""
    bone = limb[:, 1] - limb[:, 0]
    return np.asarray(bone / np.linalg.norm(bone, axis=-1, keepdims=True))


@every_rig
def test_bones_turn_no_faster_than_the_persons(
    clips: dict[str, Clip], name: str
) -> None:
    for clip in clips.values():
        rig = built_rig(load_rig_map(name), clip.body)
        motion = retarget(clip, rig)
        limbs = [rig.joint(p) for p in rig.parts if p.split()[-1] in ("arm", "shin")]
        ours, theirs = (speed(q) for q in (clip.rotations, motion.rotations[:, limbs]))
        assert theirs.max() < 1.5 * ours.max() + 0.05


def speed(rotations: Array) -> Array:
    """Return by how much rotations turn from frame to frame [rad]."""
    steps = multiply(rotations[1:], rotations[:-1] * [1, -1, -1, -1])
    return np.asarray(np.linalg.norm(rotation_vector(steps), axis=-1))


def standing(frames: int, shin: float, make_clip: Callable[..., Clip]) -> Clip:
    """Return a clip in T-pose whose shins are turned by an angle about x [rad]."""
    clip = make_clip(frames, KINECT_V2)
    rotations = np.zeros((frames, len(KINECT_V2), 4))
    rotations[..., 0] = 1.0
    for side in ("Left", "Right"):
        ankle = KINECT_V2.index(f"Ankle{side}")
        rotations[:, ankle, :2] = np.cos(shin / 2), np.sin(shin / 2)
    root = np.tile(clip.body.rest_positions[KINECT_V2.root], (frames, 1))
    return replace(
        clip,
        rotations=rotations,
        root=root,
        contacts=np.ones((frames, 4), dtype=bool),
    )


@pytest.mark.parametrize("degrees", [-3.0, 0.0, 3.0, 60.0])
def test_knees_bend_forward_even_where_noise_bent_them_back(
    make_clip: Callable[..., Clip], degrees: float
) -> None:
    clip = standing(4, np.radians(degrees), make_clip)
    rig = giant("mixamo", clip)
    motion = retarget(clip, rig)
    for side in SIDES:
        knees = bent_to(motion.positions[:, [rig.joint(f"{side} {p}") for p in LEG[0]]])
        assert (knees[:, 2] > -1e-9).all()


@every_rig
def test_a_person_in_t_pose_puts_every_rig_in_t_pose(
    make_clip: Callable[..., Clip], name: str
) -> None:
    clip = standing(2, 0.0, make_clip)
    rig = giant(name, clip)
    motion = retarget(clip, rig)
    for side, x in zip(SIDES, (1.0, -1.0), strict=True):
        arm = [rig.joint(f"{side} {part}") for part in ARM[0]]
        for bone in np.diff(motion.positions[0, arm], axis=0):
            np.testing.assert_allclose(
                bone / np.linalg.norm(bone), [x, 0.0, 0.0], atol=1e-6
            )
        leg = [rig.joint(f"{side} {part}") for part in (*LEG[0], "toes")]
        for bone in np.diff(motion.positions[0, leg[:3]], axis=0):
            np.testing.assert_allclose(
                bone / np.linalg.norm(bone), [0.0, -1.0, 0.0], atol=1e-3
            )
        foot = motion.positions[0, leg[3]] - motion.positions[0, leg[2]]
        assert foot[2] > 0.9 * np.linalg.norm(foot * [1, 0, 1])


@every_rig
def test_a_rig_of_the_persons_size_walks_as_far_as_the_person(
    clips: dict[str, Clip], name: str
) -> None:
    clip = clips["walk"]
    rig = built_rig(load_rig_map(name), clip.body)
    path = retarget(clip, rig).positions[:, rig.joint("pelvis")]
    ours = clip.positions[:, clip.skeleton.root]
    away = (path - path[0]) - (ours - ours[0])
    assert np.linalg.norm(away[:, [0, 2]], axis=-1).max() < 0.05


def test_a_rig_with_longer_legs_takes_longer_steps(clips: dict[str, Clip]) -> None:
    clip = clips["walk"]
    rig = giant("unreal", clip)
    path = retarget(clip, rig).positions[:, rig.joint("pelvis")]
    ours = clip.positions[:, clip.skeleton.root]
    leg = [clip.skeleton.index(joint) for joint in ("KneeLeft", "AnkleLeft")]
    assert rig.leg_length == pytest.approx(1.5 * clip.body.lengths[leg].sum(), rel=0.01)
    assert np.ptp(path[:, 2]) == pytest.approx(1.5 * np.ptp(ours[:, 2]), rel=0.02)


def test_joints_that_no_part_turns_turn_with_their_parents(
    clips: dict[str, Clip],
) -> None:
    clip = clips["walk"]
    rig_map = load_rig_map("unreal")
    plain = built_rig(rig_map, clip.body).rest
    hand = plain.names.index("hand_l")
    rest = RestPose(
        (*plain.names, "index_01_l", "ik_foot_root"),
        (*plain.parents, hand, 0),
        np.concatenate([plain.positions, plain.positions[[hand, 0]] + [0.1, 0, 0]]),
    )
    motion = retarget(clip, matched_rig(rig_map, rest, clip.body))
    np.testing.assert_array_equal(motion.rotations[:, -2], motion.rotations[:, hand])
    np.testing.assert_array_equal(motion.rotations[:, -1], motion.rotations[:, 0])
    aside = rotate(motion.rotations[:, 0], [0.1, 0.0, 0.0])
    apart = motion.positions[:, -1] - motion.positions[:, 0]
    np.testing.assert_allclose(apart, aside, atol=1e-12)
    assert np.ptp(motion.positions[:, 0, 2]) > 1.0
    np.testing.assert_allclose(motion.positions[:, 0, 1], 0.0, atol=1e-12)


def test_a_rig_without_toes_stands_and_walks_too(clips: dict[str, Clip]) -> None:
    clip, rig_map = clips["walk"], load_rig_map("vrm")
    bones = tuple(b for b in rig_map.bones if not (b.part or "").endswith("toes"))
    rig = built_rig(replace(rig_map, bones=bones), clip.body)
    motion = retarget(clip, rig)
    assert worst_reach(clip, rig, motion, LEG) < REACH
    for side in SIDES:
        ankle = motion.positions[:, rig.joint(f"{side} foot")]
        stands = clip.contacts[:, CONTACTS.index(f"Heel{side.capitalize()}")]
        step = np.diff(ankle, axis=0)[stands[1:] & stands[:-1]]
        assert np.linalg.norm(step, axis=-1).max() < SLIDE


@every_rig
def test_feet_that_turn_to_and_fro_where_they_stand_are_held(
    name: str, clips: dict[str, Clip]
) -> None:
    clip, rng = clips["squat"], np.random.default_rng(0)
    rotations = clip.rotations.copy()
    for side in SIDES:
        foot = clip.skeleton.index(f"Foot{side.capitalize()}")
        turns = about_y(rng.normal(0.0, 0.02, len(clip)))
        rotations[:, foot] = multiply(turns, rotations[:, foot])
    restless = replace(clip, rotations=rotations)
    rig = built_rig(load_rig_map(name), clip.body)
    assert slides(restless, rig, retarget(restless, rig)).max() < SLIDE


@every_rig
def test_toes_in_the_air_turn_with_the_foot(name: str, clips: dict[str, Clip]) -> None:
    clip = clips["kick"]
    rig = built_rig(load_rig_map(name), clip.body)
    motion, high = retarget(clip, rig), 0
    for side in SIDES:
        toes, foot = rig.joint(f"{side} toes"), rig.joint(f"{side} foot")
        air = motion.positions[:, toes, 1] > 0.15
        found, wanted = motion.rotations[air, toes], motion.rotations[air, foot]
        np.testing.assert_allclose(found, wanted, atol=1e-9)
        high += air.sum()
    assert high > 10


@pytest.mark.parametrize(("aside", "lower"), [(0.0, 1.0), (0.6, 0.8), (0.8, 0.6)])
def test_hips_are_too_high_by_what_the_leg_is_too_short(
    aside: float, lower: float, clips: dict[str, Clip]
) -> None:
    reach = built_rig(load_rig_map("mixamo"), clips["walk"].body).limb("left", *LEG[0])
    for below, short in ((0.1, 0.1), (-0.1, 0.0)):
        leg = np.array([aside * reach.sum(), lower * reach.sum() + below, 0.0])
        assert shortage(leg, reach.sum()) == pytest.approx(short, abs=1e-9)
