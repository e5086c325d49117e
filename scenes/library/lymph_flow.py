"""Scripted exercises for the flow of lymph, hands and arms only.

The four of Chiang et al. 2017 (IEEE EMBC), parts of The Optimal Lymph Flow program:
muscle-tightening deep breathing, clasp and spread, over-the-head pumping and push-down
pumping. How the arms go is told by their names and by the paper's figure 6.
"""

from __future__ import annotations

import numpy as np

from .poses import Pose, Score
from .puppet import LEFT, RIGHT, Puppet
from .script import Script


def _breathed(pose: Pose, rng: np.random.Generator, depth: float) -> Pose:
    """Return the pose with the chest raised or sunk, and a little of chance."""
    lean, turn = rng.normal(0.0, 0.04, 2)
    return pose.leaning(spine=(-0.12 * depth, lean, turn), head=(-0.1 * depth, 0, 0))


def _deep_breathing(
    puppet: Puppet, rng: np.random.Generator, base: Pose, length: float
) -> Score:
    """Breathe in with opening arms, out with tight fists and folding arms."""
    score = Score(base).hold(0.2)
    low, flare = rng.uniform(-0.42, -0.2), rng.uniform(0.4, 1.0)
    while score.duration < length:
        tight = (rng.uniform(0.04, 0.12), low + rng.normal(0.0, 0.03), 0.24)
        closed = puppet.reach_both(
            _breathed(base, rng, -0.6), tight, (flare, -1.0, -0.2)
        )
        opened = _breathed(base, rng, 1.0)
        elevation, plane = rng.uniform(0.3, 1.4), rng.uniform(-0.2, 0.6)
        bend = rng.uniform(0.2, 2.0)
        for side in (LEFT, RIGHT):
            opened = opened.with_arm(side, puppet.arm(elevation, plane, -0.6, bend))
        score.to(rng.uniform(0.9, 1.5), closed).hold(rng.uniform(0.3, 0.8))
        score.to(rng.uniform(0.9, 1.5), opened).hold(rng.uniform(0.1, 0.4))
    return score.to(0.8, base)


def _clasp_and_spread(
    puppet: Puppet, rng: np.random.Generator, base: Pose, length: float
) -> Score:
    """Clasp the hands before the chest, at the neck or overhead; spread the arms."""
    score = Score(base).hold(0.2)
    while score.duration < length:
        kind = rng.choice(["chest", "chest", "head", "behind"])
        if kind == "chest":
            spot = (0.03, rng.uniform(-0.25, 0.02), rng.uniform(0.28, 0.5))
            closed = puppet.reach_both(base, spot, (1.0, -0.6, 0.0))
        elif kind == "head":
            closed = puppet.reach_both(
                base, (0.04, rng.uniform(0.42, 0.55), 0.1), (1, 0, 0.3)
            )
        else:
            spot = (0.12, rng.uniform(0.14, 0.22), -0.06)
            closed = puppet.reach_both(base, spot, (1.0, 0.3, rng.uniform(0.2, 0.9)))
        opened = _breathed(base, rng, 0.8)
        elevation, plane = rng.uniform(1.2, 1.8), rng.uniform(-0.35, 0.3)
        bend, turn = rng.uniform(0.1, 0.7), rng.uniform(-0.9, 0.0)
        for side in (LEFT, RIGHT):
            opened = opened.with_arm(side, puppet.arm(elevation, plane, turn, bend))
        score.to(rng.uniform(0.8, 1.4), closed).hold(rng.uniform(0.1, 0.5))
        score.to(rng.uniform(0.8, 1.4), opened).hold(rng.uniform(0.1, 0.5))
    return score.to(0.8, base)


def _overhead_pumping(
    puppet: Puppet, rng: np.random.Generator, base: Pose, length: float
) -> Score:
    """Pump with fists from the shoulders up over the head."""
    score, together = Score(base).hold(0.2), rng.random() < 0.6
    out, forward = rng.uniform(0.08, 0.3), rng.uniform(0.0, 0.25)
    while score.duration < length:
        high = rng.uniform(0.38, 0.62)
        low = rng.uniform(0.02, 0.2)
        down = (out + 0.06, low, forward + 0.12)
        up = (out, high, forward)
        flare = (1.0, -0.7, rng.uniform(-0.1, 0.5))
        for beat in range(2):
            pose = _breathed(base, rng, 0.5)
            for side in (LEFT, RIGHT):
                raised = (beat == 0) if together else (beat == side)
                arm = puppet.reach(side, up if raised else down, flare)
                pose = pose.with_arm(side, arm)
            score.to(rng.uniform(0.5, 0.9), pose).hold(rng.uniform(0.0, 0.2))
    return score.to(0.9, base)


def _push_down_pumping(
    puppet: Puppet, rng: np.random.Generator, base: Pose, length: float
) -> Score:
    """Close the hands before the chest and push them down before the belly."""
    score = Score(base).hold(0.2)
    gap, flare = rng.uniform(0.03, 0.12), rng.uniform(0.6, 1.2)
    while score.duration < length:
        top = (gap, rng.uniform(-0.18, 0.0), rng.uniform(0.22, 0.28))
        raised = puppet.reach_both(_breathed(base, rng, 0.6), top, (flare, -0.5, 0.0))
        end = (
            gap + rng.uniform(0, 0.12),
            rng.uniform(-0.5, -0.4),
            rng.uniform(0.2, 0.3),
        )
        pushed = puppet.reach_both(_breathed(base, rng, -0.4), end, (1.0, -0.2, -0.4))
        score.to(rng.uniform(0.5, 1.0), raised).hold(rng.uniform(0.05, 0.3))
        score.to(rng.uniform(0.4, 0.9), pushed).hold(rng.uniform(0.05, 0.3))
    return score.to(0.8, base)


LYMPH_FLOW: dict[str, Script] = {
    "clasp_and_spread": _clasp_and_spread,
    "deep_breathing": _deep_breathing,
    "overhead_pumping": _overhead_pumping,
    "push_down_pumping": _push_down_pumping,
}
"""Exercises for the flow of lymph, by name."""
