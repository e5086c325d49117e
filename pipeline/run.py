"""The pipeline: a take in, a clip out, as one list of steps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, Clip, InputError, Prop, Skeleton, Take
from kinefilter.characters.arrays import Array
from kinefilter.retarget import measured_body

from .config import CleanConfig
from .correct import Corrector, LocalPCA, WholeTakeCorrector, correct_take
from .correct.in_turn import InTurn
from .correct.local_gp import LocalGP
from .correct.methods import FILTERS, FROM_DATABASE, LEARNED
from .database import PostureDatabase, builtin_database
from .default import default_corrector
from .failures import Failure, distrust, find_failures, unmirrored
from .formats.contacts import read_contacts
from .metrics import Quality, distances, measure
from .models import Model, load_model
from .physics import PhysicsFilter, PhysicsResult, PhysicsTrace
from .progress import Progress, silent
from .reliability import Reference, measure_reference
from .reliability.scorers import SCORERS
from .standard import standardize_take
from .target import Target, make_target
from .target.floor import to_world
from .target.person import corrected_body
from .target.placement import place_of

_MODEL_RATE = 0.5
"""Least reliability of what a model made of a measured joint: it then counts a fifth.
In simulated takes 0.5 to 0.75 do about as well."""


@dataclass(frozen=True, eq=False)
class CleanResult:
    """A cleaned clip and what happened on the way."""

    clip: Clip
    """The motion."""
    target: Array
    """Joint positions [m] before physics, the clip's frame, shape (T, J, 3)."""
    stages: dict[str, Quality]
    """Quality of ``raw``, ``corrected`` and, unless switched off, ``physics``; raw is
    the take as it was recorded, also where sides were put back."""
    coverage: Array
    """How well the database knows the posture of each frame, in [0, 1], shape (T,);
    NaN where the method has none."""
    trace: PhysicsTrace | None
    """What the simulation did, per distinct time stamp; None without physics."""
    failures: tuple[Failure, ...]
    """Where the tracker failed grossly, frames counted by distinct time stamp."""
    notes: tuple[str, ...]
    """What the user should know about this take."""

    @property
    def share_outside(self) -> float:
        """Share of the frames whose posture the method does not know, or NaN."""
        outside = np.where(np.isnan(self.coverage), np.nan, self.coverage < 0.5)
        return float(np.mean(outside))


def clean(
    take: Take,
    config: CleanConfig | None = None,
    *,
    corrector: Corrector | WholeTakeCorrector | None = None,
    progress: Progress = silent,
) -> CleanResult:
    """Clean a take.

    Args:
        take: The recording.
        config: What to do; by default joint offsets, local PCA, then physics.
        corrector: What ``make_corrector`` returned for this config and skeleton, to
            make it once for many takes, one after the other; by default made here.
        progress: Wraps the frame loops, for a progress bar.

    Raises:
        InputError: The take holds nothing to clean, or the database does not fit it.
    """
    config = config or CleanConfig()
    _check(take)
    if corrector is None:
        corrector = make_corrector(take.skeleton, config)
    distinct = np.concatenate([[True], np.diff(take.time) > 0])
    # Which distinct frame each of the take's shows; a slice copies nothing.
    frames = slice(None) if distinct.all() else np.cumsum(distinct) - 1
    source, recorded = take, take if distinct.all() else _select(take, distinct)

    failures = find_failures(recorded)
    take = unmirrored(recorded, failures)
    reference = measure_reference(take)
    body = measured_body(
        take.skeleton,
        reference.lengths,
        reference.directions,
        height=config.height,
        mass=config.mass,
        source=take.source,
    )
    reliability = SCORERS[config.scoring](take.skeleton, reference).score(take)
    reliability = distrust(reliability, failures, take.skeleton)
    standard = standardize_take(take, body, reliability)
    corrected = correct_take(standard, corrector, progress("correct", len(take)))
    del standard  # an hour's take is to fit a gigabyte
    body = corrected_body(take, corrected, height=config.height, mass=config.mass)
    contacts = None
    if config.contacts is not None:
        contacts = read_contacts(config.contacts, take.time)
    target = make_target(
        take.time,
        corrected,
        body,
        cutoff=config.cutoff,
        feet=config.feet,
        contacts=contacts,
        floor=config.floor_height,
        tilt=None if config.tilt is None else float(np.radians(config.tilt)),
    )
    origin, coverage = corrected.origin(take), corrected.coverage
    del corrected
    before = after = target.posed(body)
    mended = to_world(take.positions, target.tilt, target.floor)
    moved_by_correction = distances(before, mended)
    del mended
    raw = to_world(recorded.positions, target.tilt, target.floor)
    stages = {
        "raw": measure(take.time, raw, raw, body, target.stands),
        "corrected": measure(take.time, before, raw, body, target.stands),
    }
    rotations, trace = target.rotations, None
    force = np.full(len(take), np.nan)
    props: tuple[Prop, ...] = ()
    if config.physics:
        result, props = _simulated(take.time, target, body, config.scene, progress)
        rotations, after, trace = result.rotations, result.positions, result.trace
        force = trace.external_force
        stages["physics"] = measure(take.time, after, raw, body, target.stands)
    clip = Clip(
        time=source.time,
        root=after[frames, take.skeleton.root],
        rotations=rotations[frames],
        body=body,
        state=source.state,
        reliability=reliability.rate[frames],
        deciding_term=reliability.term[frames],
        origin=origin[frames],
        moved_by_correction=moved_by_correction[frames],
        moved_by_physics=distances(after, before)[frames],
        contacts=target.contacts[frames],
        external_force=force[frames],
        props=tuple(prop.at(frames) for prop in props),
        source=source.source,
        tilt=target.tilt,
        floor=target.floor,
    )
    notes = _notes(reference, trace, target)
    return CleanResult(
        clip, before[frames], stages, coverage[frames], trace, failures, notes
    )


def _simulated(
    time: Array, target: Target, body: Body, scene: str | None, progress: Progress
) -> tuple[PhysicsResult, tuple[Prop, ...]]:
    """Pull the character through a target, in a scene if there is one, with props."""
    character = PhysicsFilter(body, scene=scene)
    frames = progress("physics", len(time))
    if scene is None:
        result = character.run(
            time,
            target.positions,
            target.rotations,
            stands=target.stands,
            frames=frames,
        )
        return result, ()
    place = place_of(target.positions, body.skeleton)
    result = character.run(
        time,
        place.remove(target.positions),
        place.remove_rotations(target.rotations),
        stands=target.stands,
        frames=frames,
    )
    placed = replace(
        result,
        positions=place.restore(result.positions),
        rotations=place.restore_rotations(result.rotations),
    )
    return placed, result.things.props(place)


def _notes(
    reference: Reference, trace: PhysicsTrace | None, target: Target
) -> tuple[str, ...]:
    """Return what the user should know about how a take was cleaned."""
    notes = []
    if not reference.from_reference_posture:
        notes.append(
            "no T-pose or standing frames with every joint tracked: segment lengths "
            "are medians over the take"
        )
    if target.tilt != 0.0:
        notes.append(f"the sensor was tilted by {np.degrees(target.tilt):+.1f} degrees")
    if trace is not None and trace.reset.any():
        notes.append(f"physics: {trace.status}")
    return tuple(notes)


def make_corrector(
    skeleton: Skeleton, config: CleanConfig
) -> Corrector | WholeTakeCorrector:
    """Return the correction method that a config names, for a skeleton.

    Raises:
        InputError: The database or model is of another skeleton, or missing.
    """
    if config.model is not None:
        return _learned(skeleton, config, load_model(config.model))
    if config.adapt:
        raise InputError("--adapt needs --model with a model of method local-gp")
    method = config.method
    if method in LEARNED:
        raise InputError(
            f"--method {method} learns: give --model with a file of 'kinefilter train'"
        )
    if method in FILTERS:
        return FILTERS[method](skeleton)
    database = _database(skeleton, config)
    if method is None:
        return default_corrector(database, search=config.search, seed=config.seed)
    if method == "local-pca":
        return LocalPCA(database, search=config.search, seed=config.seed)
    return FROM_DATABASE[method](database)


def _database(skeleton: Skeleton, config: CleanConfig) -> PostureDatabase:
    """Return the motion database that a config names."""
    if config.database is None:
        database = builtin_database(skeleton)
    else:
        database = PostureDatabase.load(config.database)
    if database.skeleton.name != skeleton.name:
        raise InputError(
            f"{config.database}: a database of {database.skeleton.name} postures, but "
            f"the take is {skeleton.name}; build one with 'kinefilter database build "
            f"--skeleton {skeleton.name}'"
        )
    return database


def _learned(skeleton: Skeleton, config: CleanConfig, model: Model) -> Corrector:
    if model.skeleton.name != skeleton.name:
        raise InputError(
            f"{config.model}: a model for {model.skeleton.name}, but the take is "
            f"{skeleton.name}; train one on pairs of that skeleton"
        )
    if config.method not in (None, model.method, "local-pca"):
        raise InputError(
            f"{config.model}: a model of method {model.method}, but --method says "
            f"{config.method}; leave one of the two out, or let --method local-pca "
            "follow the model"
        )
    if config.adapt:
        if not isinstance(model.corrector, LocalGP):
            raise InputError(
                f"{config.model}: a model of method {model.method} cannot --adapt; "
                "train one of method local-gp"
            )
        model.corrector.adapt = True
    if config.method != "local-pca":
        return model.corrector
    database = _database(skeleton, config)
    follower = LocalPCA(database, search=config.search, seed=config.seed)
    return InTurn([model.corrector, follower], least_rate=_MODEL_RATE)


def _check(take: Take) -> None:
    present = ~np.isnan(take.positions[..., 0])
    if not present.any():
        raise InputError(
            f"{take.source}: every joint is missing in every frame; nothing to clean"
        )
    if take.time[-1] <= take.time[0]:
        raise InputError(
            f"{take.source}: the take has one distinct time stamp; "
            "a motion needs two frames or more"
        )


def _select(take: Take, kept: NDArray[np.bool_]) -> Take:
    return Take(
        take.time[kept],
        take.positions[kept],
        take.state[kept],
        take.skeleton,
        take.source,
    )
