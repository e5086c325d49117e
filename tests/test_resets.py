"""Limbs that the simulation loses, and what the clip shows until it is reset."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from known_motions import BODY, Array, stamps, standing
from real_data import TAKES, recorded

from kinefilter import CleanConfig, Cleaner, clean, read_take
from kinefilter.characters import Take, positions_from_rotations
from kinefilter.characters.anthropometry import within_ranges
from kinefilter.characters.arrays import Flags
from kinefilter.characters.rotations import IDENTITY, about_x, about_z
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.physics.filter import bridge_resets
from kinefilter.pipeline.physics.pulled_character import PulledCharacter
from kinefilter.pipeline.physics.stuck_limbs import StuckLimbs
from kinefilter.pipeline.physics.world import World

ROOT = BODY.skeleton.root


@pytest.fixture(scope="module")
def failed() -> Take:
    """A take whose tracker turns a shank upwards, where its own pull holds it."""
    return read_take(next(TAKES.rglob("m03_s06_e02_inc_failure.csv*")))


@recorded
def test_a_shank_that_the_tracker_turned_upwards_comes_down_again(failed: Take) -> None:
    target = Cleaner().without("failures", "physics").whole(failed)
    character, ankle = PulledCharacter(target.body), failed.skeleton.index("AnkleRight")
    character.start(target.positions[0], target.rotations[0])
    longest = lasts = 0
    for k, dt in enumerate(np.diff(failed.time), start=1):
        character.step(
            target.positions[k], target.rotations[k], dt, stands=target.stands[k]
        )
        away = np.linalg.norm(character.positions - target.positions[k], axis=1)[ankle]
        lasts = lasts + 1 if away > 0.3 else 0
        longest = max(longest, lasts)
    assert longest <= 4


@recorded
def test_a_clip_shows_the_target_where_a_limb_is_stuck() -> None:
    failed = read_take(next(TAKES.rglob("m04_s02_e10_inc_failure.csv*")))
    cleaner = Cleaner().without("failures")  # which removes such limbs
    target, found = cleaner.without("physics").whole(failed), cleaner.clean(failed)
    assert found.trace is not None
    assert found.trace.reset.any()
    possible = within_ranges(target.rotations, failed.skeleton)
    root = target.positions[:, failed.skeleton.root]
    possible = positions_from_rotations(possible, root, target.body)
    away = np.linalg.norm(found.clip.positions - possible, axis=2)
    assert away.max() < 0.1
    assert found.stages["physics"].float_mm < 5.0


@pytest.mark.parametrize(
    ("bent", "elsewhere", "blocked", "stuck"),
    [
        (1.2, 0.0, False, True),  # the wrist is 28 cm off
        (1.2, 0.0, True, False),
        (0.5, 0.0, False, False),
        (0.0, 0.5, False, False),
    ],
)
def test_a_hand_that_stays_off_its_target_is_stuck_unless_something_blocks_it(
    *, bent: float, elsewhere: float, blocked: bool, stuck: bool
) -> None:
    root = standing(1)[:, ROOT]
    wanted = np.tile(IDENTITY, (1, len(BODY.skeleton), 1))
    turns = wanted.copy()
    forearm = BODY.skeleton.index("WristLeft")
    turns[:, [forearm, *BODY.skeleton.descendants(forearm)]] = about_z(bent)
    pose = positions_from_rotations(turns, root + elsewhere, BODY)[0], turns[0]
    target = positions_from_rotations(wanted, root, BODY)[0], wanted[0]
    limbs = StuckLimbs(BODY)
    found = [limbs.step(pose, target, 0.04, lambda: blocked) for _ in range(5)]
    assert found == [False, False, False, stuck, stuck]


@pytest.mark.parametrize(
    ("twisted", "wanted", "stuck"),
    [(1.2, 0.0, True), (0.9, 0.0, False), (0.0, 1.2, True), (0.0, 1.5, False)],
)
def test_a_foot_that_stays_off_what_it_can_follow_is_stuck(
    twisted: float, wanted: float, *, stuck: bool
) -> None:
    root = standing(1)[:, ROOT]
    own, target = np.tile(IDENTITY, (2, 1, len(BODY.skeleton), 1))
    own[:, BODY.skeleton.index("FootRight")] = about_x(twisted)
    target[:, BODY.skeleton.index("FootRight")] = about_x(wanted)
    pose, there = (
        (positions_from_rotations(turns, root, BODY)[0], turns[0])
        for turns in (own, target)
    )
    limbs = StuckLimbs(BODY)
    found = [limbs.step(pose, there, 0.04, lambda: False) for _ in range(5)]
    assert found == [False, False, False, stuck, stuck]


def _bridged(resets: list[int], lost: slice | list[int]) -> tuple[Array, Array]:
    """Return distances [m] from a target before and after, (T, J), reset in frames."""
    count, body = 60, BODY
    roots = standing(count)[:, ROOT] + [0.0, 1.0, 0.0]
    wanted = np.tile(IDENTITY, (count, len(body.skeleton), 1))
    turns = wanted.copy()
    turns[:, body.skeleton.index("ElbowLeft")] = about_x(0.1)  # followed, not exactly
    turns[lost, body.skeleton.index("WristLeft")] = about_z(2.0)
    there = positions_from_rotations(wanted, roots, body)
    before = positions_from_rotations(turns, roots, body) - there
    own = roots.copy()
    bridge_resets(stamps(count), (turns, own), (wanted, roots), np.array(resets), body)
    after = positions_from_rotations(turns, own, body) - there
    return np.linalg.norm(before, axis=2), np.linalg.norm(after, axis=2)


@pytest.mark.parametrize("resets", [[40], [39, 40]])
@pytest.mark.parametrize("thrashes", [0, 6])
def test_only_what_was_lost_before_and_after_a_reset_is_replaced(
    thrashes: int, resets: list[int]
) -> None:
    last = 40 + thrashes
    before, after = _bridged(resets, [*range(30, resets[0]), *range(41, last + 1)])
    assert before[30:39].max() > 0.3
    assert after[29 : last + 1].max() < 1e-9
    np.testing.assert_allclose(after[:23], before[:23], atol=1e-12)
    np.testing.assert_allclose(after[last + 7 :], before[last + 7 :], atol=1e-12)


def test_a_limb_that_came_back_for_a_moment_was_lost_all_the_same() -> None:
    before, after = _bridged([40], [*range(30, 34), *range(36, 40)])
    assert before[34:36].max() < 0.1
    assert after[29:40].max() < 1e-9


def test_who_was_lost_for_longer_is_replaced_for_a_second() -> None:
    before, after = _bridged([55], slice(0, 55))
    assert after[25:55].max() < 1e-9
    np.testing.assert_allclose(after[:19], before[:19], atol=1e-12)


def test_without_a_reset_nothing_changes() -> None:
    before, after = _bridged([], slice(30, 40))
    np.testing.assert_array_equal(after, before)


def test_a_reset_is_told_with_its_time_and_a_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    step, count = World.follow, iter(range(1000))

    def follow(*arguments: Any) -> Flags:
        good = step(*arguments)
        return good & (next(count) != 39)  # ten of these hold the first target

    monkeypatch.setattr(World, "follow", follow)
    take = simulate("basic", "wave", seed=1).take.at(slice(60))
    take = replace(take, time=100.0 + np.arange(60) / 30.0)
    notes = clean(take, CleanConfig(method="none", tilt=0.0)).notes
    (told,) = (note for note in notes if note.startswith("physics: "))
    assert "reset onto its target in 1 frame, at 1.0 s: " in told
    assert told.endswith("--edits")
