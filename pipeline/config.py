"""What a user can choose; each field's docstring is also its flag's help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from kinefilter.characters import InputError, TrackingName

from .field_types import check_fields, type_hints
from .formats.takes import FORMATS
from .methods import MethodName, ScorerName
from .presets import PRESETS, Parameters, PresetName, parameters

_FARTHEST = 10_000.0  # m; no sensor sees a floor that far away

if TYPE_CHECKING:
    TakeFormat = str
else:
    TakeFormat = Literal[tuple(FORMATS)]
"""Layouts of takes by name (see ``formats/takes.py``)."""


@dataclass(frozen=True)
class CleanConfig:
    """How a take is cleaned."""

    method: MethodName | None = None
    """How joints are corrected. The default is your --model if you give one; otherwise
    the learned weights that ship, followed by local-pca, for takes of a Kinect, and
    local-pca alone for other trackers. none only fills gaps."""
    model: Path | None = None
    """Model (.npz) from 'kinefilter train'. With --method local-pca, local-pca corrects
    what the model leaves."""
    person: str | None = None
    """Who is in the take: the name of a person whom --model was trained on with
    'kinefilter train --people'."""
    adapt: bool = False
    """Let a local-gp model keep learning from the reliable frames of the take."""
    scoring: ScorerName = "shum"
    """How reliability is scored: as in Shum 2013, as in Chiang 2017, from noise and
    segment lengths, or as learned on simulated people. learned also doubts joints that
    the sensor always misplaces: best for finding errors, worse for correcting them."""
    search: Literal["solver", "stochastic"] = "solver"
    """How local-pca finds its posture: the solver, or the sampling of Shum 2013."""
    database: Path | None = None
    """Motion database (.npz) from 'kinefilter database build'; default: the one that
    ships with kinefilter, built from scripted motions. With a database of recorded
    mocap, reliable joints are corrected towards natural postures as well."""
    cutoff: float = 6.0
    """Cutoff frequency of the smoothing [Hz], 0.5 or more; 0 switches it off. Smoothing
    adds no lag."""
    reconstruct: bool = True
    """Reconstruct hidden limbs from how they moved before and after; otherwise the
    method fills them in."""
    same_person: tuple[Path, ...] = ()
    """Other takes of the same person by the same sensor, from which hidden limbs are
    reconstructed too, as far as that helps on limbs that were seen."""
    gaps: Literal["hold", "split", "refuse"] = "hold"
    """What to do with gaps of more than two seconds without a frame: hold the
    character still, split the take into several clips (clip.part1.usda,
    clip.part2.usda and so on), or refuse the take."""
    physics: bool = True
    """Pull a simulated character through the motion, so that it obeys dynamics."""
    tracking: TrackingName = "faithful"
    """How the simulated character follows: faithful; game, which gives way where it is
    hit, falls and gets up again; or ragdoll, which nothing pulls."""
    feet: Literal["auto", "always", "never"] = "auto"
    """When feet are planted: auto finds when they stand; or always, or never."""
    contacts: Path | None = None
    """When feet are planted, in place of --feet: a table from --save-contacts, edited
    or not, or a clip (.npz). A foot stands on its heel, its toes, or both; a heel that
    is off rises as far as the ankle was measured."""
    edits: Path | None = None
    """TOML file of what you saw in the take: which limbs are wrong and when, where left
    and right are swapped, when feet stand and where joints are. 'kinefilter view'
    writes it; see CONVENTIONS.md."""
    floor: Literal["auto", "none"] | float = "auto"
    """Height of the floor in the take [m]. auto finds it under the feet, none takes
    y = 0 of the take."""
    tilt: float | None = None
    """Slope of the floor along the sensor's z axis, positive where it rises away from
    the sensor [degrees]. By default it is found where somebody walks a meter or more,
    or stands 15 degrees or more off the vertical. 0 keeps the take's y axis as up."""
    scene: str | None = None
    """Surroundings, at whose origin the person begins: the name of a scene (an unknown
    name lists them), or an MJCF file (.xml); default: a floor."""
    height: float | None = None
    """The person's stature [m]; default: from the take."""
    mass: float | None = None
    """The person's mass [kg]; default: from the stature."""
    seed: int = 0
    """Seed of --search stochastic; the same seed gives the same clip."""
    preset: PresetName | None = None
    """The complete system of a paper: its reliability, method and constants, without
    the stages that it does not have. Systems that learn also need --model, from
    'kinefilter train --preset'."""
    set: tuple[str, ...] = ()
    """Parameters of --preset or --method, such as neighbors=20 steps=10. An unknown
    name lists those that exist."""

    @property
    def floor_height(self) -> float | None:
        """Height of the floor in the take [m]; None: it is to be found."""
        if self.floor == "auto":
            return None
        return 0.0 if self.floor == "none" else self.floor

    @property
    def parameters(self) -> Parameters:
        """What the preset and ``set`` say of the method, the scorer and the gains."""
        hints = type_hints(CleanConfig)
        decided = PRESETS[self.preset].stages if self.preset else {}
        stages = {n: hints[n] for n in decided if n not in ("method", "scoring")}
        method = decided.get("method", self.method)
        if self.set and method is None:
            raise InputError("--set needs --preset or --method, whose parameters it is")
        return parameters(
            self.preset, method or "default", self.scoring, self.set, stages
        )

    def _follow(self, preset: PresetName) -> None:
        """Take over what a preset decides, or raise an InputError where it cannot."""
        wanted = PRESETS[preset].stages
        object.__setattr__(self, "scoring", wanted["scoring"])
        for name, value in (wanted | self.parameters.stages).items():
            own, usual = getattr(self, name), vars(CleanConfig)[name]
            if own not in (usual, value):
                raise InputError(
                    f"--preset {preset} decides --{name} ({value}); change it with "
                    f"--set {name}=..., or leave --preset out"
                )
            object.__setattr__(self, name, value)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.preset is not None:
            self._follow(self.preset)
        elif self.set:
            self.parameters  # noqa: B018 - refuses what it does not know
        if self.cutoff != 0.0 and not 0.5 <= self.cutoff < float("inf"):
            raise InputError(
                f"--cutoff {self.cutoff:g} Hz: expected 0 (no smoothing) or 0.5 and "
                "more; 6 keeps what people do"
            )
        for name in ("scene", "tracking"):
            if getattr(self, name) != vars(CleanConfig)[name] and not self.physics:
                raise InputError(f"--{name} needs the physics; leave --no-physics out")
        if self.contacts is not None and self.feet != "auto":
            raise InputError("--contacts and --feet both say when feet stand; give one")
        if self.tilt is not None and not abs(self.tilt) < 90.0:
            raise InputError(
                f"--tilt {self.tilt:g}: expected degrees between -90 and 90"
            )
        if not isinstance(self.floor, str) and not abs(self.floor) < _FARTHEST:
            raise InputError(
                f"--floor {self.floor:g}: expected auto, none or a height in meters"
            )
        if self.seed < 0:
            raise InputError(f"--seed {self.seed}: expected 0 or more")
