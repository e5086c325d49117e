"""What a user can choose; each field's docstring is also its flag's help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from kinefilter.characters import InputError

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
    """How joints are corrected; default: by the model where one is given, otherwise
    by the weights of learned that ship, where a Kinect's tracker put the joints, then
    local-pca. none fills gaps only."""
    model: Path | None = None
    """Model (.npz) of 'kinefilter train'; with --method local-pca, that follows it."""
    person: str | None = None
    """Who is in the take: one of the people that --model knows by name, after
    'kinefilter train --people'."""
    adapt: bool = False
    """Let a model of local-gp learn on from the take, where it is sure."""
    scoring: ScorerName = "shum"
    """How reliability is scored: after Shum 2013, after Chiang 2017, by noise and
    segment lengths, or as learned on simulated people. learned doubts also what is
    always misplaced: it tells best where a take is wrong, but corrects worse."""
    search: Literal["solver", "stochastic"] = "solver"
    """How local-pca finds its posture: the solver, or the sampling of Shum 2013."""
    database: Path | None = None
    """Motion database (.npz) of 'kinefilter database build'; default: the built-in, of
    scripted motions, that ships with kinefilter. With one of recorded mocap, what no
    natural posture does is taken back as well."""
    cutoff: float = 6.0
    """Frequency [Hz] over which movement is smoothed away, without lag; 0: nothing,
    otherwise 0.5 or more."""
    reconstruct: bool = True
    """Let hidden limbs go on as they went before joints are corrected; without it,
    the method fills them."""
    same_person: tuple[Path, ...] = ()
    """Other takes of the person by the same sensor: hidden limbs move as they do there,
    too, as far as that would have helped where they were seen."""
    gaps: Literal["hold", "split", "refuse"] = "hold"
    """What to do where more than two seconds have no frame: hold the character still
    in one clip, split the take into a clip for each part, clip.part1.usda,
    clip.part2.usda and so on, or refuse the take."""
    physics: bool = True
    """Pull a simulated character through the motion, so that dynamics hold."""
    feet: Literal["auto", "always", "never"] = "auto"
    """When feet stand still on the floor: where they rest, always, or never."""
    contacts: Path | None = None
    """When feet stand still instead: a file of --save-contacts, edited or not, or a
    clip (.npz). A foot stands on heel or toe; a heel that is 0 is up only as far as
    the ankle was measured."""
    edits: Path | None = None
    """What you saw in the take: a TOML file of when which joints or limbs are wrong,
    and when left and right are exchanged; see CONVENTIONS.md."""
    floor: Literal["auto", "none"] | float = "auto"
    """Where the floor is: found under the feet, none: the take's own y = 0, or its
    height in the take [m]."""
    tilt: float | None = None
    """By how much the floor rises away along the sensor's z axis [degrees]; default:
    found where somebody walks a meter or more, or stands 15 degrees or more off the
    vertical, upside down or not; 0: the take's own y is up."""
    scene: str | None = None
    """What is around the person, who begins at its origin: a scene (an unknown name
    lists them), or an MJCF file (.xml); default: the floor alone."""
    height: float | None = None
    """The person's stature [m]; default: from the take."""
    mass: float | None = None
    """The person's mass [kg]; default: from the stature."""
    seed: int = 0
    """Seed of the stochastic search: same seed, same bytes."""
    preset: PresetName | None = None
    """A paper's system, whole: its reliability, method and constants, and no stage that
    it does not have. Those that learn need --model, of 'kinefilter train --preset'."""
    set: tuple[str, ...] = ()
    """Parameters of --preset or --method, such as neighbors=20 steps=10; an unknown
    name lists them."""

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
        if self.scene is not None and not self.physics:
            raise InputError("--scene needs the physics; leave --no-physics out")
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
