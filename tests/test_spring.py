"""The critically damped spring against an integrator."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from kinefilter.pipeline.physics.compliance import damped


def test_a_spring_moves_as_its_equation_says() -> None:
    off, speed, w, dt = np.array([0.3, -0.1]), np.array([-2.0, 0.7]), 9.0, 0.13
    way = np.concatenate([off, speed])
    exact = solve_ivp(
        lambda _, y: [*y[2:], *(-(w**2) * y[:2] - 2.0 * w * y[2:])],
        (0.0, dt),
        way,
        rtol=1e-10,
        atol=1e-12,
    ).y[:, -1]
    np.testing.assert_allclose(np.concatenate(damped(off, speed, w, dt)), exact, 1e-7)
