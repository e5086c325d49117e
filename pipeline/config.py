"""Settings of cleaning; each field's docstring is also the help of its option."""

import tomllib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from kinefilter.characters import InputError, Tracking, TrackingName

from .field_types import check_fields, converted, keyword_hints, type_hints
from .formats.takes import FORMATS
from .methods import (
    METHODS,
    PRESETS,
    SCORERS,
    MethodName,
    Parameters,
    PresetName,
    ScorerName,
    load,
)

_FARTHEST = 10_000.0  # m; no sensor sees a floor farther away
_MOST = 100_000  # beyond, a count would exhaust memory and a weight drown all others

# One list serves the command line and the readers; type checkers see Any.
TakeFormat: TypeAlias = Literal[tuple(FORMATS)]  # type: ignore[valid-type] # a table
"""Layouts of takes by name (see ``formats/takes.py``)."""


@dataclass(frozen=True)
class CleanConfig:
    """Settings for cleaning a take."""

    method: MethodName | None = None
    """Correction method. By default this is --model if given; otherwise the shipped
    learned correction followed by local-pca for takes from a Kinect, and local-pca
    alone for other trackers. none only fills gaps."""
    model: Path | None = None
    """Model file (.npz) from 'kinefilter train'. Add --method local-pca to run
    local-pca after the model."""
    person: str | None = None
    """Name of the person in the take, as given to 'kinefilter train --people' when
    --model was trained."""
    adapt: bool = False
    """Keep training a local-gp model on the reliable frames of the take."""
    scoring: ScorerName = "shum"
    """Method that scores the reliability of joints: shum (Shum 2013), chiang (Chiang
    2017), noise (from noise and segment lengths) or learned (trained on simulated
    people). learned also flags joints that the sensor always misplaces, which makes it
    best for finding errors but worse for correcting them."""
    search: Literal["solver", "stochastic"] = "solver"
    """Search of local-pca for its posture: a solver, or the sampling of Shum 2013."""
    database: Path | None = None
    """Posture database (.npz) from 'kinefilter database build'. The default is the
    shipped one, built from scripted motions. With a database of recorded mocap,
    reliable joints are also corrected toward natural postures."""
    cutoff: float = 6.0
    """Cutoff frequency of the smoothing filter [Hz], at least 0.5; 0 disables it.
    Smoothing adds no lag."""
    reconstruct: bool = True
    """Reconstruct hidden limbs from their motion before and after. Otherwise the
    correction method fills them in."""
    same_person: tuple[Path, ...] = ()
    """Other takes of the same person from the same sensor. They help to reconstruct
    hidden limbs, as far as they improve the prediction of visible ones."""
    gaps: Literal["hold", "split", "refuse"] = "hold"
    """What to do at gaps of more than two seconds without a frame: hold the character
    still, split the take into clips (clip.part1.usda, ...), or refuse the take."""
    physics: bool = True
    """Pull a simulated character through the motion, so that it obeys dynamics."""
    tracking: TrackingName = "faithful"
    """Behavior of the simulated character: faithful follows the motion closely; game
    yields when hit, falls and gets up again; ragdoll is not pulled at all."""
    feet: Literal["auto", "always", "never"] = "auto"
    """When feet are planted: auto detects it; the alternatives are always and never."""
    contacts: Path | None = None
    """File that says when feet are planted, instead of --feet: a table from
    --save-contacts, edited or not, or a clip (.npz). A foot is planted on its heel, its
    toes or both; a raised heel gets the measured height of the ankle."""
    edits: Path | None = None
    """TOML file of manual corrections: when to distrust limbs, swap left and right or
    plant feet, and positions of joints. 'kinefilter view' writes it; see
    CONVENTIONS.md."""
    floor: Literal["auto", "none"] | float = "auto"
    """Height of the floor in the take [m]; auto estimates it, none keeps y = 0."""
    tilt: float | None = None
    """Slope of the floor along the sensor's z axis [degrees], positive if it rises away
    from the sensor. By default it is estimated if the person walks a meter or more, or
    stands 15 degrees or more off the vertical. 0 keeps the take's y axis as up."""
    scene: str | None = None
    """Surroundings, with the person starting at their origin: the name of a scene (an
    unknown name lists all) or an MJCF file (.xml). The default is a bare floor."""
    height: float | None = None
    """The person's stature [m]. By default it is estimated from the take."""
    mass: float | None = None
    """The person's mass [kg]. By default it is estimated from the stature."""
    seed: int = 0
    """Random seed for --search stochastic; the same seed gives the same clip."""
    preset: PresetName | None = None
    """Complete system of a paper: its reliability, method, constants and stages only.
    Systems that learn also need --model from 'kinefilter train --preset'."""
    set: tuple[str, ...] = ()
    """Parameters of --preset or --method, such as neighbors=20 steps=10. An unknown
    name lists all of them."""

    @property
    def floor_height(self) -> float | None:
        """Height of the floor in the take [m]; None if it is to be estimated."""
        if self.floor == "auto":
            return None
        return 0.0 if self.floor == "none" else self.floor

    @property
    def parameters(self) -> Parameters:
        """Parameters of method, scorer and tracking, from the preset and ``set``.

        ``set`` has NAME=VALUE, of a keyword of the method's or scorer's constructor, a
        tracking gain, or a field that the preset decides. Raises an InputError for an
        unknown name or unsuitable value.
        """
        preset = PRESETS[self.preset] if self.preset else None
        method = preset.method if preset else self.method
        found = Parameters(dict(preset.settings) if preset else {}, {}, {}, {}, {})
        if not self.set:
            return found
        if method is None:
            raise InputError("--set needs the --preset or --method that it changes")
        hints, decided = type_hints(CleanConfig), preset.stages if preset else {}
        stages = {n: hints[n] for n in decided if n not in ("method", "scoring")}
        groups = (
            (keyword_hints(METHODS[method].load()), found.given),
            (keyword_hints(load(SCORERS[self.scoring])), found.scorer),
            (type_hints(Tracking), found.tracking),
            (stages, found.stages),
        )
        for assignment in self.set:
            name, equals, text = assignment.partition("=")
            group = next((group for group in groups if name in group[0]), None)
            if group is None or not equals:
                known = ", ".join(dict.fromkeys(n for kind, _ in groups for n in kind))
                what = f"preset {self.preset}" if preset else f"method {method}"
                expected = f"NAME=VALUE, with a parameter of {what}: {known}"
                raise InputError(f"--set {assignment}: expected {expected}")
            value: Any = text
            with suppress(tomllib.TOMLDecodeError):  # a number, true or false
                value = tomllib.loads(f"value = {text}")["value"]
            value = converted(value, group[0][name], f"--set {name}")
            if isinstance(value, int | float) and not isinstance(value, bool):
                least = int(isinstance(value, int) and name != "seed")
                if not least <= value <= _MOST:
                    wrong = f"expected {least} to {_MOST}"
                    raise InputError(f"--set {name}={value}: {wrong}")
            group[1][name] = value
        found.method.update(found.given)
        return found

    def _follow(self, preset: PresetName) -> None:
        """Take over the preset's settings; raise an InputError if they conflict."""
        wanted = PRESETS[preset].stages
        object.__setattr__(self, "scoring", wanted["scoring"])
        for name, value in (wanted | self.parameters.stages).items():
            given, default = getattr(self, name), vars(CleanConfig)[name]
            if given not in (default, value):
                wrong = f"--preset {preset} decides --{name} ({value})"
                hint = f"change it with --set {name}=..., or omit --preset"
                raise InputError(f"{wrong}; {hint}")
            object.__setattr__(self, name, value)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.preset is not None:
            self._follow(self.preset)
        elif self.set:
            self.parameters  # noqa: B018 - raises for unknown names
        if self.cutoff != 0.0 and not 0.5 <= self.cutoff < float("inf"):
            expected = "0 (no smoothing) or at least 0.5; 6 keeps human motion"
            raise InputError(f"--cutoff {self.cutoff:g} Hz: expected {expected}")
        for name in ("scene", "tracking", "same_person"):
            need = "reconstruct" if name == "same_person" else "physics"
            if getattr(self, name) != vars(CleanConfig)[name] and not vars(self)[need]:
                told = f"--{name.replace('_', '-')} needs --{need}"
                off = f"--preset {self.preset}" if self.preset else f"--no-{need}"
                raise InputError(f"{told}, which {off} turns off")
        if self.contacts is not None and self.feet != "auto":
            raise InputError("--contacts and --feet exclude each other; give one")
        if self.tilt is not None and not abs(self.tilt) <= 90.0:
            raise InputError(f"--tilt {self.tilt:g}: expected -90 to 90 degrees")
        if not isinstance(self.floor, str) and not abs(self.floor) < _FARTHEST:
            expected = "auto, none or a height in meters"
            raise InputError(f"--floor {self.floor:g}: expected {expected}")
        if self.seed < 0:
            raise InputError(f"--seed {self.seed}: expected 0 or more")
