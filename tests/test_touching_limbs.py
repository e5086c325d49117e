"""Limbs whose targets pass through the body itself."""

from __future__ import annotations

import mujoco
import numpy as np
from known_motions import BODY, pulled_through, stamps, standing

from kinefilter.characters import positions_from_rotations
from kinefilter.characters.humanoid import build_humanoid
from kinefilter.characters.rotations import IDENTITY, about_x, about_z, multiply
from kinefilter.pipeline.metrics import jitter
from kinefilter.pipeline.physics.pulled_character import PulledCharacter


def test_legs_that_swing_through_each_other_slide_and_do_not_stick() -> None:
    time, skeleton = stamps(60), BODY.skeleton
    rotations = np.tile(IDENTITY, (60, len(skeleton), 1))
    swing = 0.5 * np.sin(2.0 * np.pi * time)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        leg = [skeleton.index(f"{part}{side}") for part in ("Knee", "Ankle", "Foot")]
        inward = np.tile(about_z(-0.1 * sign), (60, 1))  # the ankles meet
        rotations[:, leg] = multiply(about_x(sign * swing), inward)[:, None]
    roots = standing(60)[:, skeleton.root] + [0.0, 1.0, 0.0]
    target = positions_from_rotations(rotations, roots, BODY)
    found = pulled_through(PulledCharacter(BODY), time, target, rotations).positions
    assert np.abs(found - target)[..., 2].max() < 0.015  # 27 mm with friction
    assert jitter(time, found) < 1.6 * jitter(time, target)  # 2.2


def test_soles_keep_their_friction_on_the_floor() -> None:
    model = build_humanoid(BODY).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    assert (data.contact.dim == 3).all()
