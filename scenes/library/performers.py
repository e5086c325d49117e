"""Scripted performers: seeded human motions on any body, with known rotations.

The seed determines amplitude, tempo, sides, stance and style, and the repetitions
within a performance differ. The motions are designed, not recorded.
"""

from collections.abc import Sequence
from dataclasses import replace
from zlib import crc32

import numpy as np

from kinefilter.characters import Body, InputError, Motion, Skeleton, standard_body
from kinefilter.characters.arrays import Array, check_choice, check_kind
from kinefilter.characters.rotations import continuous, multiply, normalize

from .actions import ACTIONS
from .clearance import clear_arms
from .exercises import EXERCISES
from .gaits import GAITS, TURNS, Area, gait
from .gestures import GESTURES
from .poses import LEFT, RIGHT, Pose, Rng, Score, within_ranges
from .prop_motions import PROP_MOTIONS, TASKS
from .puppet import Puppet
from .sports import SPORTS
from .stances import stance

_SCRIPTS = GESTURES | ACTIONS | TURNS | EXERCISES | SPORTS | PROP_MOTIONS

MOTIONS = tuple(sorted((*_SCRIPTS, *GAITS)))
"""Names of the motions that ``perform`` knows. Some come in two versions: as people do
them of their own accord (squat, lunge, step_over, sit, raise_leg), and as an exercise
often done wrong (deep_squat, inline_lunge, hurdle_step, sit_to_stand, leg_raise)."""

_EXTRA_WIDTH = {
    "dance": -0.5,
    "kick": 0.2,
    "deep_squat": 0.7,
    "squat": 0.9,
    "dodge": 1.0,
}
_EXTRA_WIDTH |= dict.fromkeys(("bend_leg", "hurdle_step", "leg_raise"), -0.3)
_EXTRA_WIDTH |= dict.fromkeys(("pick_up", "sit", "sit_to_stand"), 0.4)
_EXTRA_WIDTH |= dict.fromkeys(("punch", "swing"), 0.3)
"""Extra distance between the feet, in hip widths, by motion."""

_USUAL_EXTRA_WIDTH = -0.25  # of all other motions: the feet are 11 to 29 cm apart

_STAGGERED = {*GESTURES, "dance", "dodge"}
"""Motions that are also performed with one foot in front."""

_HIPS_AHEAD = (0.035, 0.02)
"""Mean and standard deviation of how far [m] the hips are in front of the ankles in
quiet standing: the line of gravity passes about 5 cm in front of the ankles and just
behind the hips (Winter 1995, Gait Posture 3(4))."""

_TRUNK_TILT = (-0.03, 0.05)  # rad, in standing: mean and deviation, a guess

_SHORTEST, _TALLEST = 1.5, 2.0  # m, of random bodies: about 99 % of adults
# Mean and standard deviation of stature [m], men and women, in ANSUR II (Gordon et al.
# 2014, 2012 Anthropometric Survey of U.S. Army Personnel, Natick/TR-15/007), rounded.
_STATURES = ((1.756, 0.069), (1.629, 0.064))
# Relative standard deviation of segment lengths among people of the same stature. Based
# on the same survey's coefficients of variation among all statures (sitting height 4 %,
# arm and leg segments 5 %, biacromial breadth 4.6 %); the share that remains at one
# stature is a guess.
_BUILD = {"trunk": 0.03, "Shoulder": 0.04, "Hip": 0.05}
_BUILD |= dict.fromkeys(("Elbow", "Wrist", "Knee", "Ankle"), 0.03)
_MASS_INDEX = (23.5, 2.5)  # kg/m^2: mean and standard deviation, a guess

_SWAY_RATES = np.array([0.13, 0.29, 0.61])  # Hz: balance and breathing


def random_body(skeleton: Skeleton, rng: np.random.Generator) -> Body:
    """Draw the stature, build and mass of a symmetric body, alike on every skeleton."""
    check_kind(rng, np.random.Generator, "rng")
    mean, deviation = _STATURES[int(rng.integers(2))]
    height = float(np.clip(rng.normal(mean, deviation), _SHORTEST, _TALLEST))
    index = float(np.clip(rng.normal(*_MASS_INDEX), 18.5, 30.0))
    scale = {part: 1.0 + sd * rng.normal() for part, sd in _BUILD.items()}
    body = standard_body(skeleton, height=height, mass=index * height**2)
    factors = [
        scale["trunk"] if kind == joint else scale.get(kind, 1.0)
        for kind, joint in zip(skeleton.kinds, skeleton.joints, strict=True)
    ]
    return replace(body, lengths=body.lengths * np.array(factors))


def perform(
    name: str, body: Body, *, seed: int, fps: float = 30.0, within: Area | None = None
) -> Motion:
    """Return one performance of a motion; it lasts at least 5 s.

    The last movement is always complete. The character starts near the origin of the
    world, facing +z, or with ``within`` at the start of its loop. ``name`` is one of
    MOTIONS, or of TASKS, which fit one scene; InputError for others. The seed
    determines style, tempo and sides. ``within`` is the area in which the root stays in
    gaits, which then go around it with shorter steps; by default they go straight
    ahead.
    """
    check_choice(name, (*MOTIONS, *TASKS), "motion")
    rng = np.random.default_rng([seed, crc32(name.encode())])
    puppet = Puppet(body)
    length = rng.uniform(5.0, 9.0)
    if name in GAITS:
        time = np.arange(0.0, length, 1.0 / fps)
        pose = gait(name, puppet, rng, time, within)
    else:
        base = stance(puppet, rng, wide=_EXTRA_WIDTH.get(name, _USUAL_EXTRA_WIDTH))
        ahead = rng.normal(*_HIPS_AHEAD) * puppet.scale
        tilt = float(rng.normal(*_TRUNK_TILT))
        base = base.leaning(back=-float(ahead), pelvis=tilt)
        base = _varied(name, puppet, base, rng)
        time, pose = (_SCRIPTS | TASKS)[name](puppet, rng, base, length).sample(fps)
    pose = within_ranges(_swaying(pose, time, rng))
    pose = clear_arms(puppet, pose, fps)
    return _motion(name, puppet, time, pose)


def _varied(name: str, puppet: Puppet, base: Pose, rng: Rng) -> Pose:
    u = rng.uniform
    for side in (LEFT, RIGHT):
        arm = puppet.arm(u(0.1, 0.3), u(-1.0, 0.9), u(0.0, 0.7), u(0.1, 0.6))
        base = base.with_arm(side, arm)
    if name not in _STAGGERED or (name in GESTURES and rng.random() < 0.5):
        return base
    sign, step = int(rng.choice([-1, 1])), u(0.1, 0.6) * puppet.leg
    ankle = base.ankle.copy()
    ankle[:, 2] += np.array([0.5, -0.5]) * sign * step
    drop = puppet.leg - np.sqrt(puppet.leg**2 - (step / 2.0) ** 2)
    drop, yaw = float(drop) + u(0.0, 0.06) * puppet.leg, -0.3 * sign * step
    return replace(base, ankle=ankle).leaning(drop=drop, pelvis=(yaw, 0.0, 0.0))


def perform_medley(
    parts: Sequence[tuple[str, float]], body: Body, *, seed: int
) -> Motion:
    """Return several motions on the spot, one after another, at 30 frames per second.

    ``parts`` are their names and the minimum duration of each [s]. Unlike in
    ``perform``, arms may pass through the body. Raises an InputError if a motion does
    not stay on the spot, or without parts.
    """
    if not parts:
        raise InputError("a medley needs at least one motion")
    rng, puppet = np.random.default_rng(seed), Puppet(body)
    base = stance(puppet, rng, wide=0.4)
    score = Score(base)
    for name, seconds in parts:
        check_choice(name, MOTIONS, "motion")
        if name in GAITS:
            raise InputError(
                f"{name!r} does not stay on the spot, so a medley cannot contain it; "
                f"choose from {', '.join(sorted(_SCRIPTS))}"
            )
        score.append(_SCRIPTS[name](puppet, rng, base, seconds))
        score.to(0.4, base)
    time, pose = score.sample(30.0)
    name = " ".join(name for name, _ in parts)
    return _motion(name, puppet, time, _swaying(pose, time, rng))


def _motion(name: str, puppet: Puppet, time: Array, pose: Pose) -> Motion:
    rotations, positions = puppet.solve(pose)
    root, turns = positions[:, puppet.body.skeleton.root], continuous(rotations)
    return Motion(time=time, body=puppet.body, root=root, rotations=turns, source=name)


def _swaying(pose: Pose, time: Array, rng: Rng) -> Pose:
    def sway(*shape: int) -> Array:
        weights = rng.normal(0.0, 0.6, (3, *shape))
        phases = rng.uniform(0.0, 2.0 * np.pi, (3, *shape))
        turns = 2.0 * np.pi * np.multiply.outer(time, _SWAY_RATES)
        turns = turns.reshape(len(time), 3, *(1 for _ in shape))
        return np.asarray(np.sum(weights * np.sin(turns + phases), axis=1))

    wobble = np.concatenate([np.ones((len(time), 2, 1)), 0.01 * sway(2, 3)], axis=-1)
    return replace(
        pose,
        root=pose.root + sway(3) * np.array([0.006, 0.0, 0.006]),
        pelvis=pose.pelvis + 0.008 * sway(3),
        spine=pose.spine + 0.015 * sway(3),
        head=pose.head + 0.03 * sway(3),
        arm=multiply(normalize(wobble), pose.arm),
        elbow=np.clip(pose.elbow + 0.03 * sway(2), 0.02, 2.6),
        hand=pose.hand + 0.1 * sway(2, 2) + np.array([0.0, 0.1]),
    )
