"""Time per frame of every stage of cleaning, and whole takes per second."""

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
from kinefilter.pipeline.physics.pulled_character import PulledCharacter
from kinefilter.pipeline.physics.stage import Physics
from kinefilter.pipeline.physics.world import steps_in
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.reliability import measure_body
from kinefilter.pipeline.stages import Stage
from kinefilter.pipeline.workers import cores, workers
from kinefilter.scenes import SAMPLE

_TAKES_PER_CORE = 6  # timed takes
_WARM_UP = 10  # first frames, which are not counted
_BARE_EVERY = 10  # frames between timings of the bare engine, which slow the stages


class Timed(Stage):
    """Runs another stage and records how long it takes."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self.name = stage.name
        self.seconds: list[float] = []  # of each frame or, offline, take

    def start(self, body: Body) -> None:
        """Reset the stage for a new motion."""
        self.stage.start(body)

    def step(self, draft: Draft) -> None:
        """Process and time the next frame."""
        begun = perf_counter()
        self.stage.step(draft)
        self.seconds.append(perf_counter() - begun)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Process and time a whole take."""
        begun = perf_counter()
        self.stage.whole(draft, progress)
        self.seconds.append(perf_counter() - begun)


def bench(path: Path | None = None) -> dict[str, Any]:
    """Return the times of cleaning a take, by default the sample that ships."""
    take = read_take(path or SAMPLE)
    return {
        **_time_stages(take),
        "search": _compare_searches(take, LocalPCA(builtin_database(take.skeleton))),
        "offline": _time_offline(take),
    }


def _time_offline(take: Take) -> dict[str, float]:
    """Return how many frames per second all cores together clean in whole takes."""
    count = cores()
    with workers(count) as pool:
        list(pool.map(clean, [take] * 2 * count))  # warm up: imports, database
        start = perf_counter()
        done = list(pool.map(clean, [take] * _TAKES_PER_CORE * count))
        seconds = perf_counter() - start
    frames = sum(len(result.clip) for result in done)
    return {"cores": count, "frames_per_second": frames / seconds}


def _compare_searches(take: Take, corrector: LocalPCA) -> dict[str, float]:
    cleaner = Cleaner().until("standardize")
    cleaner.start(measure_body(take))
    generator = np.random.default_rng(0)
    times, lower = [], []
    for k in range(len(take)):
        frame = cleaner.step(take.positions[k], float(take.time[k]), take.state[k])
        corrector.step(Observation(frame.standard, frame.reliability, frame.geometry))
        energy = corrector.energy
        start = energy.space.latent[0]
        marks = [perf_counter()]
        solved = solve(energy, start)
        marks.append(perf_counter())
        sampled = stochastic_search(energy, start, generator)
        marks.append(perf_counter())
        times.append(np.diff(marks))
        ours, theirs = energy(np.array([solved, sampled]))[0]
        lower.append(ours <= theirs + 1e-12)
    solver, stochastic = np.median(times, axis=0) * 1e3
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
            # Interleaved, because the machine may slow down within a second.
            bare.append(_bare_physics(physics.character, spare, 1.0 / take.fps))
    # Medians, because other work on the machine delays single frames.
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
    avatar, times = Avatar(body), []
    for k in range(len(take)):
        start = perf_counter()
        avatar.step(take.positions[k], float(take.time[k]), take.state[k])
        times.append(perf_counter() - start)
    return float(np.median(times[_WARM_UP:]) * 1e3)


def _bare_physics(character: PulledCharacter, spare: mujoco.MjData, dt: float) -> float:
    """Return the time that the engine alone takes for the substeps of a frame [s]."""
    substeps = prod(steps_in(dt))
    character.model.opt.timestep = dt / substeps
    mujoco.mj_copyData(spare, character.model, character.data)
    start = perf_counter()
    for _ in range(substeps):
        mujoco.mj_step(character.model, spare)
    return perf_counter() - start


def as_table(figures: dict[str, Any]) -> Table:
    """Return the figures for a terminal."""
    search, offline = figures["search"], figures["offline"]
    times = {
        **figures["ms_per_frame"],
        "live frame, in total": figures["avatar_ms_per_frame"],
        "mj_step alone": figures["mj_step_ms_per_frame"],
        "search alone: solver": search["solver_ms"],
        "search alone: stochastic": search["stochastic_ms"],
    }
    table = Table("stage", "ms per frame", title=f"{figures['frames']} frames")
    for stage, value in times.items():
        table.add_row(stage, f"{value:.3f}")
    speed = f"{offline['frames_per_second']:.0f} frames/s"
    table.add_row(f"whole takes, {offline['cores']} cores", speed)
    share = search["share_of_frames_lower_energy"]
    table.caption = f"the solver reaches the lower energy in {share:.1%} of the frames"
    return table
