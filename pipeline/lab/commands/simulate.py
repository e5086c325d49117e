"""The command ``simulate``, which records with virtual sensors."""

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from kinefilter.characters import InputError, State
from kinefilter.pipeline.commands.terminal import Skeletons, check_output, out
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.formats.files import numbered
from kinefilter.pipeline.formats.plain import counted

_MOST_SENSORS = 4


@dataclass(frozen=True)
class Simulate:
    """Record a scripted motion with a virtual Kinect, so that the truth is known."""

    scene: Positional[str]
    """Surroundings of the person: the name of a scene (an unknown name lists them), or
    an MJCF file (.xml)."""
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    """Take to write (.csv); required unless --pairs is given."""
    motion: str | None = None
    """What the person does, such as walk, tai_chi or lift_box; default: a motion that
    fits the scene. squat, lunge, step_over, sit and raise_leg are everyday movements;
    deep_squat, inline_lunge, hurdle_step, sit_to_stand and leg_raise are exercises,
    often done wrong. Walking, running, marching and carrying stay in the sensor's view.
    May also be a mocap file (BVH, AMC, C3D or TRC of joint centers), played in the
    middle of the room. store_box carries the box of the scene box to its table, dribble
    dribbles the ball of the scene basketball."""
    sensor: Literal["v1", "v2", "azure"] = "v2"
    """Model of the Kinect."""
    tracker: Literal["model", "depth"] = "model"
    """How joints are found: model adds errors like a Kinect's to the truth; depth finds
    joints in rendered depth images (Shotton et al. 2011), about 20 frames per
    second."""
    skeleton: Skeletons | None = None
    """Skeleton of the take; default: the sensor's."""
    seed: int = 0
    """Seed of person, performance and errors; the same seed gives the same file."""
    sensors: int = 1
    """Number of sensors around the person, each with its own clock and errors; writes
    take.1.csv, take.2.csv and so on, for merge."""
    degrees: float = 90.0
    """Angle around the person from each sensor to the next [degrees]."""
    truth: Path | None = None
    """Also write the true motion to this file (.csv), in the frame of reference of the
    first sensor."""
    pairs: Path | None = None
    """Also write take and truth as a pairs file (.npz), for train and evaluate."""

    def run(self) -> int:
        """Simulate and write the take or takes."""
        from kinefilter.pipeline.lab import simulation as lab

        if self.seed < 0:
            raise InputError(f"--seed {self.seed}: must be at least 0")
        if not 1 <= self.sensors <= _MOST_SENSORS:
            raise InputError(f"--sensors {self.sensors}: must be 1 to {_MOST_SENSORS}")
        if not isfinite(self.degrees):
            raise InputError(f"--degrees {self.degrees}: must be finite")
        if self.sensors == 1 and self.degrees != Simulate.degrees:
            raise InputError("--degrees needs --sensors 2 or more")
        if self.out is None and self.pairs is None:
            raise InputError("nothing to write; name a take with -o, or --pairs")
        check_output(self.out, self.truth, self.pairs, suffix=".csv")
        check_output(self.truth, suffix=".csv")
        check_output(self.pairs, suffix=".npz")
        motion = self.motion or lab.motion_for(self.scene)
        paths = [] if self.out is None else [self.out]
        if self.sensors > 1:
            if (self.skeleton, self.pairs, self.tracker) != (None, None, "model"):
                raise InputError("--skeleton, --pairs and --tracker are for one sensor")
            paths = [numbered(paths[0], k + 1) for k in range(self.sensors)]
            for path in paths:
                check_output(path, self.truth)
            sensors, degrees = [self.sensor] * self.sensors, self.degrees
            views = lab.simulate_session(
                self.scene, motion, sensors=sensors, degrees=degrees, seed=self.seed
            )
            pairs = [view.pair for view in views]
        else:
            pairs = [
                lab.simulate(
                    self.scene,
                    motion,
                    sensor=self.sensor,
                    skeleton=self.skeleton,
                    seed=self.seed,
                    stay_in_view=True,
                    tracker=self.tracker,
                )
            ]
        for path, pair in zip(paths, pairs, strict=False):
            write_take_csv(pair.take, path)
        if self.truth is not None:
            write_take_csv(lab.truth_of(pairs[0]), self.truth)
        if self.pairs is not None:
            lab.write_pairs(pairs, self.pairs)
        files = [*paths, self.truth, self.pairs]
        written = ", ".join(str(file) for file in files if file is not None)
        if len(pairs) == 1:
            take = pairs[0].take
            tracked = (take.state == State.TRACKED).mean()
            written += f": {counted(len(take), 'frame')}, {tracked:.0%} tracked"
        out.print(f"wrote {written}")
        return 0
