"""How long every stage takes, frame by frame, one frame at a time."""

from __future__ import annotations

from math import prod
from pathlib import Path
from time import perf_counter
from typing import Any

import mujoco
import numpy as np
from rich.table import Table

from kinefilter.characters import Body, Take
from kinefilter.pipeline.avatar import Avatar
from kinefilter.pipeline.cleaner import Cleaner, clean
from kinefilter.pipeline.correct import LocalPCA, Observation
from kinefilter.pipeline.correct.posture_space import solve, stochastic_search
from kinefilter.pipeline.database import builtin_database
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.physics.pulled_character import PulledCharacter, steps_in
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.reliability import measure_body
from kinefilter.pipeline.stages import Physics, Stage
from kinefilter.pipeline.workers import cores, workers
from kinefilter.scenes import SAMPLE

_TAKES_PER_CORE = 6  # that are cleaned side by side
_WARM_UP = 10  # frames that are run and not counted
_BARE_EVERY = 10  # frames: often enough to compare, and the others stay undisturbed


class Timed(Stage):
    """Does what another stage does, and times it.

    Args:
        stage: The other stage.
    """

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self.name = stage.name
        self.seconds: list[float] = []
        """How long each frame, or each take, took [s]."""

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self.stage.start(body)

    def step(self, draft: Draft) -> None:
        """Do and time the next frame."""
        begun = perf_counter()
        self.stage.step(draft)
        self.seconds.append(perf_counter() - begun)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Do and time a whole take."""
        begun = perf_counter()
        self.stage.whole(draft, progress)
        self.seconds.append(perf_counter() - begun)


def sample_path() -> Path:
    """Return the recording that comes with kinefilter."""
    return SAMPLE


def bench(path: Path | None = None) -> dict[str, Any]:
    """Return milliseconds a frame of every stage, and how the two searches compare.

    Args:
        path: Take to time on; by default the sample that comes with kinefilter.
    """
    take = read_take(path or sample_path())
    return {
        **_time_stages(take),
        "search": _compare_searches(take, LocalPCA(builtin_database(take.skeleton))),
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
    cleaner = Cleaner().until("standardize")
    cleaner.start(measure_body(take))
    generator = np.random.default_rng(0)
    times, energies = [], []
    for k in range(len(take)):
        frame = cleaner.step(take.positions[k], float(take.time[k]), take.state[k])
        seen = Observation(frame.standard, frame.reliability, frame.geometry)
        corrector.step(seen)
        energy = corrector.energy
        start = energy.space.latent[0]
        marks = [perf_counter()]
        solved = solve(energy, start)
        marks.append(perf_counter())
        sampled = stochastic_search(energy, start, generator)
        marks.append(perf_counter())
        times.append(np.diff(marks))
        energies.append(energy(np.array([solved, sampled]))[0])
    solver, stochastic = np.median(times, axis=0) * 1e3
    lower = [e[0] <= e[1] + 1e-12 for e in energies]
    return {
        "solver_ms": float(solver),
        "stochastic_ms": float(stochastic),
        "times_faster": float(stochastic / solver),
        "share_of_frames_lower_energy": float(np.mean(lower)),
    }


def _time_stages(take: Take) -> dict[str, Any]:
    cleaner, body = Cleaner(), measure_body(take)
    timed = [Timed(stage) for stage in cleaner.stages]
    cleaner = cleaner.replaced(*timed)
    cleaner.start(body)
    (physics,) = (t.stage for t in timed if isinstance(t.stage, Physics))
    spare, bare = mujoco.MjData(physics.character.model), list[float]()
    for k in range(len(take)):
        cleaner.step(take.positions[k], float(take.time[k]), take.state[k])
        if k % _BARE_EVERY == 0:
            # Among the stages: a machine may be slower a second later.
            bare.append(_bare_physics(physics.character, spare, 1.0 / take.fps))
    # The median: a machine that does other things too makes single frames late.
    times = np.array([stage.seconds[_WARM_UP:] for stage in timed]) * 1e3
    medians = np.median(times, axis=1).tolist()
    return {
        "frames": len(take),
        "ms_per_frame": {
            **{stage.name: ms for stage, ms in zip(timed, medians, strict=True)},
            "total": float(np.median(times.sum(axis=0))),
        },
        "avatar_ms_per_frame": _time_avatar(take, body),
        "mj_step_ms_per_frame": float(np.median(bare) * 1e3),
    }


def _time_avatar(take: Take, body: Body) -> float:
    """Return how long a frame of the live character takes [ms], checks included."""
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
    substeps = prod(steps_in(dt))
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
