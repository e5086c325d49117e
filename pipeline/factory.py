"""Builds the correction method that a config asks for, from its model file or anew."""

from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton, skeleton_named, standard_body

from .config import CleanConfig
from .correct import Corrector, CorrectorChain, LearnedCorrector, LocalPCA, Observation
from .database import PostureDatabase, builtin_database
from .formats.files import as_path, refused
from .formats.npz import read_arrays, write_arrays
from .methods import LEARNED, METHODS

_VERSION = 1
_DAMAGED = (ArithmeticError, AttributeError, IndexError, MemoryError, TypeError)
"""Exceptions from unsuitable arrays, besides errors in their values and names."""
_FARTHEST = 1.0  # m: no sensor misplaces a joint of a T-pose by more


@dataclass(frozen=True)
class Model:
    """A learned corrector and its provenance."""

    corrector: LearnedCorrector  # the fitted method
    method: str  # name of the method
    skeleton: Skeleton  # the joints it was trained for
    source: str  # the training data, in words
    preset: str | None = None  # the preset it was trained as


def save_model(model: Model, path: Path) -> None:
    """Write a model as npz; the file appears whole or not at all."""
    arrays: dict[str, Any] = {
        "version": np.array(_VERSION),
        "method": np.array(model.method),
        "skeleton": np.array(model.skeleton.name),
        "trained_on": np.array(model.source),
        "preset": np.array(model.preset or ""),
    }
    fitted = model.corrector.arrays().items()
    write_arrays(path, arrays | {f"fitted_{key}": array for key, array in fitted})


def shipped_model(skeleton: Skeleton) -> LearnedCorrector:
    """Return the shipped corrector (from ``lab.training``) for a skeleton."""
    model = copy(_shipped(skeleton))  # shares the arrays, which never change
    model.start()
    return model


@lru_cache(maxsize=4)
def _shipped(skeleton: Skeleton) -> LearnedCorrector:
    path = Path(__file__).with_name("embedded") / "learned.npz"
    return _corrector(skeleton, "learned", read_arrays(path))


def _corrector(
    skeleton: Skeleton, method: str, arrays: dict[str, NDArray[Any]]
) -> LearnedCorrector:
    """Return the corrector of a method from the arrays of a file."""
    prefix = "fitted_"
    fitted = {k.removeprefix(prefix): arrays[k] for k in arrays if k.startswith(prefix)}
    found: LearnedCorrector = LEARNED[method].load().from_arrays(skeleton, fitted)
    return found


def _try_out(corrector: LearnedCorrector) -> None:
    """Raise ValueError or one of _DAMAGED if a corrector displaces a T-pose far."""
    body = standard_body(corrector.skeleton)
    posture = np.tile(body.rest_positions, (3, 1, 1))
    posture -= posture[:, body.skeleton.root, None]
    reliable, sensor = np.ones(posture.shape[:2]), np.tile([2.0, 0.0, 1.0], (3, 1))
    time = np.arange(3) / 30
    take = Observation(posture, reliable, reliable, time, body.lengths, sensor)
    for person in (None, *getattr(corrector, "people_", np.array([])).tolist()):
        corrector.select_person(person)
        for found in (corrector.whole(take), corrector.step(take.at(0))):
            moved = np.abs(found.positions - posture[0]).max()
            if not moved < _FARTHEST:
                raise ValueError(f"it moves a T-pose by {moved:.3g} m")
    corrector.select_person(None)
    corrector.start()


def load_model(path: Path) -> Model:
    """Read a model; raises InputError if it is missing, damaged or too new."""
    if not as_path(path).is_file():
        raise InputError(f"{path}: no such model; create one with 'kinefilter train'")
    arrays = read_arrays(path, "a model from 'kinefilter train'")
    with refused(path, "not a kinefilter model; create one with 'kinefilter train'"):
        version, method = int(arrays["version"].item()), str(arrays["method"])
        skeleton = skeleton_named(str(arrays["skeleton"]))
        source = str(arrays["trained_on"])
        preset = str(arrays.get("preset", "")) or None
    if version > _VERSION or method not in LEARNED:
        raise InputError(
            f"{path}: a model of method {method!r}, version {version}, which this "
            f"kinefilter does not know (it knows {', '.join(LEARNED)}, version "
            f"{_VERSION}); update kinefilter or train again"
        )
    try:
        corrector = _corrector(skeleton, method, arrays)
        with np.errstate(all="ignore"):
            _try_out(corrector)
    except (InputError, KeyError, ValueError, *_DAMAGED) as error:
        wrong = f"no array {error}" if isinstance(error, KeyError) else error
        told = f"a damaged or outdated model: {wrong}; train again"
        raise InputError(f"{path}: {told}") from None
    return Model(corrector, method, skeleton, source, preset)


_MINIMUM = 0.5
"""Minimum reliability of a measured joint after a model corrected it, which makes it
count a fifth. On simulated takes 0.5 to 0.75 do about equally well."""


def make_corrector(
    skeleton: Skeleton, config: CleanConfig, *, by_kinect: bool = True
) -> Corrector:
    """Return the correction method of a config for a skeleton.

    The default for joints from other trackers (not ``by_kinect``) is local PCA alone.
    Raises an InputError if the database or model is missing or for another skeleton.
    """
    name = config.method or ("default" if by_kinect else "local-pca")
    asked = f"--preset {config.preset}" if config.preset else f"--method {name}"
    alone = config.model is not None and config.method != "local-pca"
    if config.database and (alone or METHODS[name].requires != "database"):
        user = "a --model alone" if alone else asked
        raise InputError(f"{user} does not use --database; add --method local-pca")
    if config.model is not None:
        model = load_model(config.model)
        try:
            learned = _adapted(skeleton, config, model)
        except InputError as error:
            raise InputError(f"{config.model}: {error}") from None
        if alone:
            return learned
        methods, least = (learned, _build("local-pca", skeleton, config)), _MINIMUM
        return CorrectorChain(*methods, least_reliability=least)
    if config.adapt:
        raise InputError("--adapt needs a --model of method local-gp")
    if config.person is not None:
        raise InputError("--person needs a --model from 'kinefilter train --people'")
    if METHODS[name].requires == "pairs":
        trained = f"a --model from 'kinefilter train {asked}'"
        raise InputError(f"{asked} needs training: give {trained}")
    return _build(name, skeleton, config, **config.parameters.method)


def _build(
    name: str, skeleton: Skeleton, config: CleanConfig, **constants: Any
) -> Corrector:
    method = METHODS[name]
    base = skeleton if method.requires == "skeleton" else _database(skeleton, config)
    options = {option: getattr(config, option) for option in method.options}
    corrector: Corrector = method.make(base, **(options | constants))
    return corrector


def default_corrector(database: PostureDatabase, **options: Any) -> Corrector:
    """Return the shipped learned corrector followed by local PCA with ``options``."""
    pca = LocalPCA(database, **options)
    return CorrectorChain(shipped_model(database.skeleton), pca)


def _database(skeleton: Skeleton, config: CleanConfig) -> PostureDatabase:
    if config.database is None:
        return builtin_database(skeleton)
    database = PostureDatabase.load(config.database)
    if database.skeleton.name != skeleton.name:
        raise InputError(
            f"{config.database}: a database of {database.skeleton.name} postures, but "
            f"the take is {skeleton.name}; build one with 'kinefilter database build "
            f"--skeleton {skeleton.name}'"
        )
    return database


def _adapted(skeleton: Skeleton, config: CleanConfig, model: Model) -> Corrector:
    """Return a model's corrector with the parameters and person of the config."""
    if model.skeleton.name != skeleton.name:
        raise InputError(
            f"a model for {model.skeleton.name}, but the take is {skeleton.name}; "
            "train one on pairs of that skeleton"
        )
    if config.preset is not None and config.preset != model.preset:
        hint = f"train one with 'kinefilter train --preset {config.preset}'"
        raise InputError(f"not a model of preset {config.preset}; {hint}")
    if config.method not in (None, model.method, "local-pca"):
        raise InputError(
            f"a model of method {model.method}, but --method is {config.method}; omit "
            "--method, or use --method local-pca to run local-pca after the model"
        )
    corrector: Any = model.corrector
    if config.parameters.given:
        corrector = corrector.adjusted(**config.parameters.given)
    if config.person is not None:
        people = corrector.people_.tolist() if model.method == "learned" else []
        if config.person not in people:
            known = f"only {', '.join(people)}" if people else "nor anyone else"
            hint = "train it on people with 'kinefilter train --people'"
            raise InputError(f"does not know {config.person!r}, {known}; {hint}")
        corrector.select_person(config.person)
    if config.adapt:
        if "adapt" not in METHODS[model.method].options:
            what = f"a model of method {model.method}"
            raise InputError(f"{what} cannot --adapt; train one with --method local-gp")
        corrector.adapt = True
    return cast("Corrector", corrector)
