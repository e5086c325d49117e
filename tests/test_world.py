"""Several characters in one world: they push each other, and nothing else."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    TRACKINGS,
    InputError,
    Tracking,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.humanoid import MOST_CHARACTERS, build_humanoids
from kinefilter.characters.rotations import IDENTITY, about_x, about_y
from kinefilter.pipeline.physics.pulled_character import PulledCharacter
from kinefilter.pipeline.physics.world import World

Array = NDArray[np.float64]
BODIES = (standard_body(KINECT_V2, height=1.8), standard_body(KINECT_V1, height=1.6))
BOTH = np.ones(2, dtype=bool)
CRATE = """<mujoco><worldbody><geom type="plane" size="5 5 1"/>
<body name="crate" pos="0.4 0 0.2"><freejoint/>
<geom type="box" size="0.2 0.2 0.2" mass="4"/></body></worldbody></mujoco>"""


class Pair:
    """Two people in T-pose who face +x, the second one ``apart`` [m] before them."""

    def __init__(
        self, apart: float, tracking: Tracking | None = None, scene: Path | None = None
    ) -> None:
        self.world = World(BODIES, tracking, scene=scene)
        self.people = [PulledCharacter(b, tracking, world=self.world) for b in BODIES]
        self.places = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, apart]])
        for person, target in zip(self.people, self.targets(), strict=True):
            person.start(*target)

    def targets(self) -> list[tuple[Array, Array]]:
        return [
            (
                person.body.rest_positions + place,
                np.tile(IDENTITY, (len(person.body.rest_positions), 1)),
            )
            for person, place in zip(self.people, self.places, strict=True)
        ]

    def step(self, frames: int = 1, walk: float = 0.0) -> NDArray[np.bool_]:
        """Step; the first one walks so far [m] towards the second in each frame."""
        for _ in range(frames):
            self.places[0, 2] += walk
            targets = zip(self.people, self.targets(), strict=True)
            moves = [person.plan(*target, 1 / 30) for person, target in targets]
            good = self.world.follow(moves, [BOTH, BOTH])
        return good

    def momenta(self) -> Array:
        """Return the momentum of each [kg m/s], in MuJoCo's world, (2, 3)."""
        model, data = self.world.model, self.world.data
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        roots = [model.body(name).id for name in ("SpineBase", "2:HipCenter")]
        return np.array([person.body.mass for person in self.people])[
            :, None
        ] * np.asarray(data.subtree_linvel[roots])

    def touch(self) -> bool:
        """Return whether the two are in contact."""
        model, data = self.world.model, self.world.data
        roots = model.body_rootid[model.geom_bodyid[data.contact.geom]]
        return bool(((roots > 0).all(axis=1) & (np.diff(roots)[:, 0] != 0)).any())


def relaxed(person: PulledCharacter, root: Array) -> tuple[Array, Array]:
    """Return a target 1 m above the floor, with limbs bent as springs hold them."""
    skeleton, back = person.body.skeleton, np.radians(30.0)
    turns = np.tile(IDENTITY, (len(skeleton), 1))
    for part, sides in (
        ("Wrist", (about_y(-back), about_y(back))),
        ("Ankle", (about_x(back), about_x(back))),
    ):
        for joint, turn in zip(skeleton.sides(part), sides, strict=True):
            turns[[joint, *skeleton.descendants(joint)]] = turn
    high = root + np.array([0.0, 1.0, 0.0])
    return positions_from_rotations(turns, high, person.body), turns


def test_two_who_collide_exchange_momentum() -> None:
    pair = Pair(0.8, TRACKINGS["ragdoll"])
    pair.world.model.opt.gravity[:] = 0.0
    for person, target in zip(pair.people, pair.targets(), strict=True):
        person.start(*relaxed(person, target[0][person.body.skeleton.root]))
    pair.people[0].push("SpineMid", [0.0, 0.0, 900.0], 0.1)
    pair.step(3)
    before = pair.momenta()
    assert before[0, 0] > 80.0
    assert np.abs(before[1]).max() < 1e-6
    data, largest = pair.world.data, 0.0
    roots = [pair.world.model.joint(n).dofadr[0] for n in ("SpineBase", "2:HipCenter")]
    for _ in range(20):
        pair.step()
        one, other = (data.qfrc_constraint[k : k + 3] for k in roots)
        np.testing.assert_allclose(one, -other, atol=1e-6)
        largest = max(largest, float(np.linalg.norm(one)))
    assert largest > 50.0
    gained = pair.momenta() - before
    assert gained[1, 0] > 20.0
    # The engine's steps keep the momentum of tumbling bodies to some percent.
    np.testing.assert_allclose(gained.sum(axis=0), 0.0, atol=0.04 * before[0, 0])


def test_who_is_walked_into_gives_way_and_the_pulls_say_what_it_took() -> None:
    pair = Pair(0.9)
    assert pair.step(30).all()
    standing = [person.external_force for person in pair.people]
    assert pair.step(30, walk=0.025).all()  # up to 0.15 m before the other
    assert pair.touch()
    first, second = (person.root[2] for person in pair.people)
    assert second - first > 0.175  # they do not pass through each other
    assert second > pair.places[1, 2] + 0.01
    assert [p.external_force for p in pair.people] > standing


def test_a_person_who_runs_into_another_counts_as_a_blow() -> None:
    pair = Pair(1.0, TRACKINGS["game"])
    pair.step(30)
    second = pair.people[1].compliance
    assert second is not None
    assert second.frequencies.min() == 1.0
    doing = set()
    for _ in range(12):
        pair.step(walk=0.1)
        doing.add(second.doing)
    assert "fell" in doing


def test_far_from_each_other_each_moves_as_if_alone() -> None:
    pair, alone = Pair(5.0), PulledCharacter(BODIES[0])
    alone.start(*pair.targets()[0])
    for _ in range(45):
        pair.step(walk=0.03)
        alone.step(*pair.targets()[0], 1 / 30, stands=BOTH)
        together = pair.people[0]
        np.testing.assert_allclose(together.positions, alone.positions, atol=1e-6)
        assert abs(together.external_force - alone.external_force) < 1e-4


@pytest.mark.parametrize("speed", [1e5, 1e12])
def test_one_who_diverges_is_put_back_without_touching_others_or_props(
    speed: float, tmp_path: Path
) -> None:
    scene = tmp_path / "crate.xml"
    scene.write_text(CRATE)
    courses = []
    for spoiled in (False, True):
        pair = Pair(1.0, scene=scene)
        root = pair.world.model.joint("2:HipCenter").dofadr[0]
        crate, course = pair.world.data.body("crate"), []
        for frame in range(20):
            if spoiled and frame == 10:
                pair.world.data.qvel[root : root + 3] = speed
            good = pair.step(walk=0.01)
            assert list(good) == [True, not (spoiled and frame == 10)]
            place = pair.people[0].positions.ravel(), crate.xpos
            course.append(np.concatenate(place))
        courses.append(course)
        away = np.abs(pair.people[1].positions - pair.targets()[1][0])
        assert away.max() < 0.01
        assert np.isfinite(pair.world.data.xfrc_applied).all()
    np.testing.assert_allclose(courses[1], courses[0], atol=1e-5)
    assert np.ptp(np.array(courses[0])[:, -3]) > 0.02  # the crate was pushed


def test_a_prop_that_one_pushes_reaches_the_other(tmp_path: Path) -> None:
    scene = tmp_path / "crate.xml"
    scene.write_text(CRATE)
    pair = Pair(0.8, scene=scene)
    pair.step(30)
    assert pair.world.model.nbody == 2 + sum(
        2 * len(body.skeleton.joints) for body in BODIES
    )
    model, data = pair.world.model, pair.world.data
    crate, reached = model.body("crate").id, False
    for _ in range(45):
        pair.step(walk=0.01)
        touching = model.body_rootid[model.geom_bodyid[data.contact.geom]]
        touched = set(touching[(touching == crate).any(axis=1)].ravel())
        reached |= {model.body(n).id for n in ("SpineBase", "2:HipCenter")} <= touched
    assert reached


def test_who_is_let_go_falls_and_the_other_stands() -> None:
    pair = Pair(3.0)
    pair.people[1].limp = True
    pair.step(60)
    heights = [
        person.positions[BODIES[k].skeleton.girdle, 1]
        for k, person in enumerate(pair.people)
    ]
    assert heights[1] < 0.5 < 1.0 < heights[0]
    pair.people[0].limp, pair.people[1].limp = True, False
    for person, target in zip(pair.people, pair.targets(), strict=True):
        person.start(*target)
    pair.step(6)
    assert pair.people[0].external_force == 0.0 < pair.people[1].external_force


def test_one_who_is_not_solid_only_stands_on_the_floor() -> None:
    pair = Pair(0.9)
    pair.people[1].set_solid(False)
    pair.step(30)
    pair.step(36, walk=0.025)
    assert not pair.touch()
    assert pair.people[1].external_force < 0.1  # the floor carries it
    pair.people[1].set_solid(True)
    pair.step()
    assert pair.touch()


def test_too_many_characters_are_refused() -> None:
    with pytest.raises(InputError, match="at most"):
        build_humanoids([BODIES[0]] * (MOST_CHARACTERS + 1))
    build_humanoids([BODIES[0]] * MOST_CHARACTERS).compile()
