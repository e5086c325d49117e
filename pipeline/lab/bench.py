"""How long every stage takes, frame by frame, one frame at a time."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from time import perf_counter
from typing import Any

import mujoco
import numpy as np
from rich.table import Table

from kinefilter.characters import Body, Take
from kinefilter.pipeline.avatar import Avatar
from kinefilter.pipeline.correct import Corrector, LocalPCA, Observation
from kinefilter.pipeline.correct.posture_space import PostureSpace
from kinefilter.pipeline.correct.search import solve, stochastic_search
from kinefilter.pipeline.database import builtin_database
from kinefilter.pipeline.default import default_corrector
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.physics.pulled_character import PulledCharacter, substeps_in
from kinefilter.pipeline.reliability import ReliabilityScorer, measure_reference
from kinefilter.pipeline.run import clean
from kinefilter.pipeline.target.floor import floor_height, put_on_floor
from kinefilter.pipeline.workers import cores, workers
from kinefilter.retarget.body_size import Standardizer, measured_body
from kinefilter.retarget.bone_lengths import BoneLengths
from kinefilter.retarget.orientation import rotations_from_positions

_STAGES = ("reliability", "correct", "orientation", "physics")
_TAKES_PER_CORE = 6  # that are cleaned side by side
_WARM_UP = 10  # frames that are run and not counted
_BARE_EVERY = 10  # frames: often enough to compare, and the others stay undisturbed


def sample_path() -> Path:
    """Return the recording that comes with kinefilter."""
    folder = Path(str(resources.files("kinefilter.scenes"))) / "takes"
    (sample,) = folder.glob("*.csv")
    return sample


def bench(path: Path | None = None) -> dict[str, Any]:
    """Return milliseconds a frame of every stage, and how the two searches compare.

    Args:
        path: Take to time on; by default the sample that comes with kinefilter.
    """
    take = read_take(path or sample_path())
    database = builtin_database(take.skeleton)
    return {
        **_time_stages(take, default_corrector(database)),
        "search": _compare_searches(take, LocalPCA(database)),
        "offline": _time_offline(take),
    }


def _time_offline(take: Take) -> dict[str, float]:
    """Return how many frames a second whole takes are cleaned at, on all cores."""
    count = cores()
    with workers(count) as pool:
        list(pool.map(clean, [take] * 2 * count))  # imports, database
        start = perf_counter()
        done = list(pool.map(clean, [take] * _TAKES_PER_CORE * count))
        seconds = perf_counter() - start
    frames = sum(len(result.clip) for result in done)
    return {"cores": count, "frames_per_second": frames / seconds}


def _compare_searches(take: Take, corrector: LocalPCA) -> dict[str, float]:
    """Return how the solver and the paper's sampling do in the same posture spaces."""
    reference = measure_reference(take)
    body = measured_body(take.skeleton, reference.lengths, reference.directions)
    scorer = ReliabilityScorer(take.skeleton, reference)
    standardizer, energy = Standardizer(body), corrector.energy
    generator = np.random.default_rng(0)
    times, energies = [], []
    for k in range(len(take)):
        rate, _, geometry = scorer.step(
            take.positions[k], take.state[k], float(take.time[k])
        )
        standard, _ = standardizer.step(take.positions[k], rate)
        corrector.step(Observation(standard, rate, geometry))
        space = PostureSpace(energy.neighbors, corrector.dimensions)
        start = space.project(energy.neighbors[0])
        marks = [perf_counter()]
        solved = solve(space, energy, start)
        marks.append(perf_counter())
        sampled = stochastic_search(space, energy, start, generator)
        marks.append(perf_counter())
        times.append(np.diff(marks))
        energies.append(energy(space.posture(np.array([solved, sampled]))))
    solver, stochastic = np.median(times, axis=0) * 1e3
    lower = [e[0] <= e[1] + 1e-12 for e in energies]
    return {
        "solver_ms": float(solver),
        "stochastic_ms": float(stochastic),
        "times_faster": float(stochastic / solver),
        "share_of_frames_lower_energy": float(np.mean(lower)),
    }


def _time_stages(take: Take, corrector: Corrector) -> dict[str, Any]:
    reference = measure_reference(take)
    body = measured_body(take.skeleton, reference.lengths, reference.directions)
    scorer = ReliabilityScorer(take.skeleton, reference)
    standardizer, lengths = Standardizer(body), BoneLengths(body)
    character = PulledCharacter(body)
    present = (~np.isnan(take.positions[..., 0])).astype(float)
    stands = np.zeros((len(take), 2), dtype=np.bool_)
    floor = np.array([0.0, floor_height(take.positions, present, stands, body), 0.0])
    times, bare = np.zeros((len(take), len(_STAGES))), list[float]()
    spare = mujoco.MjData(character.model)
    corrector.start()
    for k in range(len(take)):
        marks = [perf_counter()]
        rate, _, geometry = scorer.step(
            take.positions[k], take.state[k], float(take.time[k])
        )
        marks.append(perf_counter())
        standard, view = standardizer.step(take.positions[k], rate)
        found = corrector.step(Observation(standard, rate, geometry))
        target = standardizer.undo(found.positions, view)
        marks.append(perf_counter())
        target = put_on_floor(
            lengths.project((target - floor)[None], found.trust[None]), body
        )[0]
        prior = found.rotations
        if prior is not None:
            prior = view.restore_rotations(prior)
        rotations = rotations_from_positions(target, body, prior)
        marks.append(perf_counter())
        if k == 0:
            character.start(target, rotations)
        else:
            step = max(float(take.time[k] - take.time[k - 1]), 1e-3)
            character.step(target, rotations, step)
        marks.append(perf_counter())
        times[k] = np.diff(marks)
        if k % _BARE_EVERY == 0:
            # Among the stages: a machine may be slower a second later.
            bare.append(_bare_physics(character, spare, 1.0 / take.fps))
    # The median: a machine that does other things too makes single frames late.
    stages = np.median(times[_WARM_UP:], axis=0) * 1e3
    return {
        "frames": len(take),
        "ms_per_frame": {
            **dict(zip(_STAGES, stages.tolist(), strict=True)),
            "total": float(np.median(times[_WARM_UP:].sum(axis=1)) * 1e3),
        },
        "avatar_ms_per_frame": _time_avatar(take, body),
        "mj_step_ms_per_frame": float(np.median(bare) * 1e3),
    }


def _time_avatar(take: Take, body: Body) -> float:
    """Return how long a frame of the live character takes [ms].

    Smoothing and feet, which the stages by themselves leave out, are in it.
    """
    avatar, times = Avatar(body), []
    for seconds, joints, state in zip(
        take.time, take.positions, take.state, strict=True
    ):
        start = perf_counter()
        avatar.step(joints, float(seconds), state)
        times.append(perf_counter() - start)
    return float(np.median(times[_WARM_UP:]) * 1e3)


def _bare_physics(character: PulledCharacter, spare: mujoco.MjData, dt: float) -> float:
    """Return how long a frame of nothing but the engine's substeps takes [s].

    From where the character is, on other data, so that nothing of it changes.
    """
    substeps = substeps_in(dt)
    character.model.opt.timestep = dt / substeps
    mujoco.mj_copyData(spare, character.model, character.data)
    start = perf_counter()
    for _ in range(substeps):
        mujoco.mj_step(character.model, spare)
    return perf_counter() - start


def as_table(figures: dict[str, Any]) -> Table:
    """Return the figures for a terminal."""
    table = Table("stage", "ms a frame", title=f"{figures['frames']} frames")
    for stage, value in figures["ms_per_frame"].items():
        table.add_row(stage, f"{value:.3f}")
    table.add_row("a live frame in all", f"{figures['avatar_ms_per_frame']:.3f}")
    table.add_row("mj_step alone", f"{figures['mj_step_ms_per_frame']:.3f}")
    search = figures["search"]
    table.add_row("search alone: solver", f"{search['solver_ms']:.3f}")
    table.add_row("search alone: stochastic", f"{search['stochastic_ms']:.3f}")
    offline = figures["offline"]
    table.add_row(
        f"whole takes, {offline['cores']} cores",
        f"{offline['frames_per_second']:.0f} frames/s",
    )
    share = search["share_of_frames_lower_energy"]
    table.caption = f"the solver reaches the lower energy in {share:.1%} of the frames"
    return table
