"""Builds the correction method that a config asks for."""

from typing import Any, cast

from kinefilter.characters import InputError, Skeleton

from .config import CleanConfig
from .correct import Corrector, CorrectorChain, LocalPCA
from .database import PostureDatabase, builtin_database
from .methods import METHODS
from .models import Model, load_model, shipped_model

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
    if config.model is not None:
        model = load_model(config.model)
        try:
            learned = _adapted(skeleton, config, model)
        except InputError as error:
            raise InputError(f"{config.model}: {error}") from None
        if config.method != "local-pca":
            return learned
        methods, least = (learned, _build("local-pca", skeleton, config)), _MINIMUM
        return CorrectorChain(*methods, least_reliability=least)
    if config.adapt:
        raise InputError("--adapt needs a --model of method local-gp")
    if config.person is not None:
        raise InputError("--person needs a --model from 'kinefilter train --people'")
    name = config.method or ("default" if by_kinect else "local-pca")
    if METHODS[name].requires == "pairs":
        asked = f"--preset {config.preset}" if config.preset else f"--method {name}"
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
            known = f"only {', '.join(people)}" if people else "and no one else"
            hint = "train it on people with 'kinefilter train --people'"
            raise InputError(f"does not know {config.person!r}, {known}; {hint}")
        corrector.select_person(config.person)
    if config.adapt:
        if "adapt" not in METHODS[model.method].options:
            what = f"a model of method {model.method}"
            raise InputError(f"{what} cannot --adapt; train one with --method local-gp")
        corrector.adapt = True
    return cast("Corrector", corrector)
