"""Balls that are thrown at a person who waits for them with both hands.

    python tests/caught_balls.py [--seed 1000] [--count 60]

counts those that are held a second later, with and without hands that catch.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from test_holding import BODY, reaching

from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.pipeline.physics.catch import Catch
from kinefilter.pipeline.physics.pulled_character import PulledCharacter

Array = NDArray[np.float64]
SCENE = """
<mujoco model="ball">
  <worldbody>
    <body name="ball" pos="0 9 0.2">
      <freejoint name="ball"/>
      <geom name="ball" type="sphere" size="{radius}" mass="{mass}"/>
    </body>
  </worldbody>
</mujoco>
"""
_PALMS = BODY.skeleton.sides("Hand")
_WAIT, _FRAMES = 10, 60  # frames until the throw, and all of them


@dataclass(frozen=True)
class Thrown:
    """What became of a ball, and of who was to catch it."""

    held: bool
    heights: Array  # of the ball [m], (T,)
    away: float  # farthest that a hand was from the performer's [m]
    force: float  # strongest external force [body weights]


def thrown(seed: int, *, aside: float = 0.0, apart: float = 0.0) -> Thrown:
    """Throw a ball at a person; ``aside`` of the hands, which are farther ``apart``.

    Its size, mass, speed, direction and aim are random, and so is where the hands are.
    """
    rng = np.random.default_rng(seed)
    radius, mass = rng.uniform(0.1, 0.13), rng.uniform(0.4, 5.0)
    gap = radius + rng.uniform(0.0, 0.12) + apart
    tremble = np.cumsum(rng.normal(0.0, 0.001, (2, _FRAMES)), axis=1)
    height = rng.uniform(0.9, 1.3) + tremble[1]
    positions, rotations = reaching(gap + 0.3 * tremble[0], height)
    palms = positions[_WAIT, _PALMS].mean(axis=0)
    angle, distance = np.radians(rng.uniform(-35.0, 35.0)), rng.uniform(1.5, 3.5)
    start = palms + distance * np.array([np.sin(angle), 0.0, np.cos(angle)])
    start[1] = rng.uniform(0.8, 1.8)
    aim = palms + rng.normal(0.0, 0.12, 3) + [aside, 0.0, 0.0]
    seconds = distance / rng.uniform(3.0, 8.0)
    velocity = (aim - start) / seconds + [0.0, 0.5 * GRAVITY * seconds, 0.0]
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "ball.xml"
        scene.write_text(SCENE.format(radius=radius, mass=mass))
        character = PulledCharacter(BODY, scene=scene)
    character.start(positions[0], rotations[0])
    ball, heights, aways, forces = character.data.joint("ball"), [], [], []
    for k in range(1, _FRAMES):
        if k == _WAIT:
            ball.qpos[:3], ball.qvel[:3] = to_mujoco(start), to_mujoco(velocity)
        stands = np.ones(2, dtype=bool)
        character.step(positions[k], rotations[k], 1 / 30, stands=stands)
        off = character.positions[_PALMS] - positions[k, _PALMS]
        aways.append(np.linalg.norm(off, axis=-1).max())
        heights.append(float(ball.qpos[2]))
        forces.append(character.external_force)
    held = character.grasp.held is not None
    return Thrown(held, np.array(heights), float(max(aways)), max(forces))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--count", type=int, default=60)
    given = parser.parse_args()
    seeds = range(given.seed, given.seed + given.count)
    balls = [thrown(seed) for seed in seeds]
    with mock.patch.object(Catch, "of", return_value=None):
        rival = [thrown(seed) for seed in seeds]
    for name, results in (("with hands that catch", balls), ("without", rival)):
        held = sum(ball.held for ball in results)
        force = np.mean([ball.force for ball in results])
        Console(highlight=False).print(
            f"{name}: {held} of {given.count} held; strongest external force "
            f"{force:.2f} body weights"
        )
