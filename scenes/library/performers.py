"""Scripted performers: seeded human motions on any body, with known rotations.

Every motion is a family: a seed draws its amplitude, tempo, sides, stance and style,
and no repetition within a performance equals another. They are imagined motions, not
recordings: ranges of motion are those of healthy adults, the timing is plausible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from zlib import crc32

import numpy as np

from kinefilter.characters import Body, InputError, Motion
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import continuous, multiply, normalize

from .actions import ACTIONS
from .clearance import clear_arms
from .exercises import EXERCISES, LYMPH_FLOW
from .gaits import GAITS, TURNS, Area, gait
from .gestures import GESTURES
from .poses import LEFT, RIGHT, Pose, Rng, Score, within_ranges
from .prop_motions import PROP_MOTIONS
from .puppet import Puppet
from .sports import SPORTS
from .stances import stance

_SCRIPTS = GESTURES | ACTIONS | TURNS | EXERCISES | LYMPH_FLOW | SPORTS | PROP_MOTIONS

MOTIONS = tuple(sorted((*_SCRIPTS, *GAITS)))
"""Names of the motions that ``perform`` knows.

Of some there are two: as people do them by themselves (squat, lunge, step_over, sit,
raise_leg), and as an exercise that holds the arms and is often done wrong (deep_squat,
inline_lunge, hurdle_step, sit_to_stand, leg_raise).
"""

_EXTRA_WIDTH = {
    "deep_squat": 0.7,
    "bend_leg": -0.3,
    "dance": -0.5,
    "dodge": 1.0,
    "hurdle_step": -0.3,
    "kick": 0.2,
    "leg_raise": -0.3,
    "pick_up": 0.4,
    "punch": 0.3,
    "sit": 0.4,
    "sit_to_stand": 0.4,
    "squat": 0.9,
    "swing": 0.3,
}
"""Hip widths by which people stand wider or narrower for a motion."""

_CLOSER = -0.25
"""Hip widths by which the others differ: feet 11 to 29 cm apart."""

_STAGGERED = {*GESTURES, "dance", "dodge"}
"""Motions that people do with one foot in front, too."""

_HIPS_AHEAD = (0.035, 0.02)
"""Mean and standard deviation [m] of the hips before the ankles in quiet standing: the
line of gravity passes about 5 cm before the ankles and just behind the hips (Winter
1995, Gait Posture 3(4))."""

_TRUNK_TILT = (-0.03, 0.05)
"""Mean and standard deviation [rad] of the trunk's tilt in standing, a guess."""

_SWAY_RATES = np.array([0.13, 0.29, 0.61])  # Hz: balance and breathing


def perform(
    name: str, body: Body, *, seed: int, fps: float = 30.0, within: Area | None = None
) -> Motion:
    """Return one performance of a motion, of 5 s or more: its last movement ends.

    The character starts near the origin of the world and faces +z; with ``within`` it
    starts where its loop does.

    Args:
        name: One of MOTIONS.
        body: Who performs, on any skeleton kinefilter knows.
        seed: Draws style, tempo and sides; the same seed gives the same arrays.
        fps: Frames per second.
        within: Where the root stays in gaits (carry, march, run, walk), which then go
            around in it with shorter steps; by default they go straight ahead. Other
            motions are the same with it.

    Raises:
        InputError: There is no motion of that name.
    """
    _check(name, MOTIONS)
    rng = np.random.default_rng([seed, crc32(name.encode())])
    puppet = Puppet(body)
    length = rng.uniform(5.0, 9.0)
    if name in GAITS:
        time = np.arange(0.0, length, 1.0 / fps)
        pose = gait(name, puppet, rng, time, within)
    else:
        base = stance(puppet, rng, wide=_EXTRA_WIDTH.get(name, _CLOSER))
        ahead = rng.normal(*_HIPS_AHEAD) * puppet.scale
        tilt = float(rng.normal(*_TRUNK_TILT))
        base = base.leaning(back=-float(ahead), pelvis=(0.0, tilt, 0.0))
        base = _as_one_stands(name, puppet, base, rng)
        time, pose = _SCRIPTS[name](puppet, rng, base, length).sample(fps)
    pose = within_ranges(_alive(pose, time, rng))
    pose = clear_arms(puppet, pose, fps)
    return _performed(name, puppet, time, pose)


def _as_one_stands(name: str, puppet: Puppet, base: Pose, rng: Rng) -> Pose:
    """Return a stance with arms hanging as they like and perhaps a foot in front."""
    u = rng.uniform
    for side in (LEFT, RIGHT):
        arm = puppet.arm(u(0.1, 0.3), u(-1.0, 0.9), u(0.0, 0.7), u(0.1, 0.6))
        base = base.with_arm(side, arm)
    if name not in _STAGGERED or (name in GESTURES and rng.random() < 0.5):
        return base
    way, step = int(rng.choice([-1, 1])), u(0.1, 0.6) * puppet.leg
    ankle = base.ankle.copy()
    ankle[:, 2] += np.array([0.5, -0.5]) * way * step
    drop = puppet.leg - np.sqrt(puppet.leg**2 - (step / 2.0) ** 2)
    base = replace(base, ankle=ankle)
    return base.leaning(
        drop=float(drop) + u(0.0, 0.06) * puppet.leg,
        pelvis=(-0.3 * way * step, 0.0, 0.0),
    )


def perform_medley(
    parts: Sequence[tuple[str, float]], body: Body, *, seed: int
) -> Motion:
    """Return several motions one after another on feet that stay where they are.

    30 frames a second. Unlike those of ``perform``, arms may go through the body.

    Args:
        parts: Names of motions on the spot, and the least duration of each [s].
        body: Who performs, on any skeleton kinefilter knows.
        seed: Draws style, tempo and sides; the same seed gives the same arrays.

    Raises:
        InputError: A name is not one of a motion on the spot, or there is no part.
    """
    if not parts:
        raise InputError("a medley needs at least one motion")
    rng, puppet = np.random.default_rng(seed), Puppet(body)
    base = stance(puppet, rng, wide=0.4)
    score = Score(base)
    for name, seconds in parts:
        _check(name, MOTIONS)
        if name in GAITS:
            known = ", ".join(sorted(_SCRIPTS))
            raise InputError(f"{name!r} leaves its place; a medley takes {known}")
        score.append(_SCRIPTS[name](puppet, rng, base, seconds))
        score.to(0.4, base)
    time, pose = score.sample(30.0)
    name = " ".join(name for name, _ in parts)
    return _performed(name, puppet, time, _alive(pose, time, rng))


def _check(name: str, known: tuple[str, ...]) -> None:
    if name not in known:
        raise InputError(f"unknown motion {name!r}; known: {', '.join(known)}")


def _performed(name: str, puppet: Puppet, time: Array, pose: Pose) -> Motion:
    rotations, positions = puppet.solve(pose)
    return Motion(
        time=time,
        body=puppet.body,
        root=positions[:, puppet.body.skeleton.root],
        rotations=continuous(rotations),
        source=name,
    )


def _alive(pose: Pose, time: Array, rng: Rng) -> Pose:
    """Add the small sway of a living body to everything but the feet."""

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
