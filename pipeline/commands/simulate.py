"""``kinefilter simulate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from kinefilter.characters import State

from .terminal import Skeletons, check_output, keep, out


@dataclass(frozen=True)
class Simulate:
    """Let a virtual Kinect record a scripted motion, so that the truth is known."""

    scene: Positional[str]
    """Surroundings of the person: a scene (an unknown name lists the scenes), or an
    MJCF file (.xml)."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Take to write (.csv)."""
    motion: str | None = None
    """What the person does, such as walk, tai_chi or lift_box; default: what fits the
    scene. People squat, lunge, step_over, sit and raise_leg in everyday life;
    deep_squat, inline_lunge, hurdle_step, sit_to_stand and leg_raise are exercises,
    often done wrong. Who walks, runs, marches or carries stays in the sensor's view."""
    sensor: Literal["v1", "v2", "azure"] = "v2"
    """Which Kinect records."""
    skeleton: Skeletons | None = None
    """Skeleton of the take; default: the sensor's."""
    seed: int = 0
    """Seed of person, performance and errors: same seed, same bytes."""
    truth: Path | None = None
    """Also write the true motion to this file (.csv)."""
    pairs: Path | None = None
    """Also write take and truth as a pairs file (.npz), to train and evaluate with."""

    def run(self) -> int:
        """Simulate the take and write it."""
        from kinefilter.pipeline.formats import write_take_csv
        from kinefilter.pipeline.lab.simulate import (
            motion_for,
            simulate,
            truth_of,
            write_pairs,
        )

        check_output(self.out, ".csv")
        check_output(self.truth, ".csv")
        check_output(self.pairs, ".npz")
        keep(self.out, self.truth, self.pairs)
        pair = simulate(
            self.scene,
            self.motion or motion_for(self.scene),
            sensor=self.sensor,
            skeleton=self.skeleton,
            seed=self.seed,
            stay_in_view=True,
        )
        write_take_csv(pair.take, self.out)
        if self.truth is not None:
            write_take_csv(truth_of(pair), self.truth)
        if self.pairs is not None:
            write_pairs([pair], self.pairs)
        tracked = (pair.take.state == State.TRACKED).mean()
        frames = f"{len(pair.take)} frame{'s' * (len(pair.take) != 1)}"
        out.print(f"wrote {self.out}: {frames}, {tracked:.0%} tracked")
        return 0
