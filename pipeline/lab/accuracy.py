"""Errors of a motion against the ground truth of marker mocap or a simulation."""

from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from scipy.ndimage import uniform_filter1d

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.skeleton import LIMB_PARTS, SIDES
from kinefilter.pipeline.metrics import jitter
from kinefilter.pipeline.pairs import PairedTake

LIMBS = tuple(part + side for part in LIMB_PARTS for side in SIDES)
"""The scored joints, which mocap and Kinect define alike, at least in principle."""

FAR = 0.07  # m: offset-free error above which a joint counts as wrong
MISPLACED = 0.12  # m, likewise, averaged over half a second, to warn about
_AVERAGED = 0.5  # s over which that error is averaged
_SHORTEST = 1e-3  # s between two frames


class Accuracy:
    """Errors of limb joints, relative to the midpoint of the hips."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self.limbs = [skeleton.index(joint) for joint in LIMBS]
        self._lengths = standard_body(skeleton).lengths

    def distances(self, positions: Array, truth: Array) -> Array:
        """Return E per frame and limb joint [m], NaN where unknown, shape (T, 12).

        Positions and truth [m], shape (T, J, 3), have the same frames and orientation.
        """
        return np.asarray(np.linalg.norm(self.away(positions, truth), axis=2))

    def standardized(self, positions: Array, truth: Array) -> Array:
        """Return E_std [m], with standard bone lengths on both sides, (T, 12)."""
        return self.distances(self._standard(positions), self._standard(truth))

    def varying(self, positions: Array, truth: Array) -> Array:
        """Return E_var [m], less each joint's constant offset, (T, 12)."""
        away = self.away(positions, truth)
        return np.asarray(np.linalg.norm(away - mean_of_known(away), axis=2))

    def hips(self, time: Array, positions: Array, truth: Array) -> Array:
        """Return the error of the velocity of the hips' middle [m/s], (T - 1,).

        It is NaN where unknown; time stamps [s] increase.
        """
        middle = (positions - truth)[:, self.skeleton.hips].mean(axis=1)
        speed = np.linalg.norm(np.diff(middle, axis=0), axis=1)
        return np.asarray(speed / np.maximum(np.diff(time), _SHORTEST))

    def away(self, positions: Array, truth: Array) -> Array:
        """Return error vectors of limb joints [m], NaN where unknown, (T, 12, 3)."""
        return self._from_hips(positions) - self._from_hips(truth)

    def _from_hips(self, positions: Array) -> Array:
        middle = positions[:, self.skeleton.hips].mean(axis=1, keepdims=True)
        return np.asarray((positions - middle)[:, self.limbs])

    def _standard(self, positions: Array) -> Array:
        """Give bones standard lengths; the trunk is one, for mocap without a spine."""
        skeleton = self.skeleton
        standard = np.full_like(positions, np.nan)
        standard[:, skeleton.root] = 0.0
        for j in skeleton.order[1:]:
            parent, length = skeleton.parents[j], self._lengths[j]
            if j == skeleton.girdle:
                length += self._lengths[parent]
                parent = skeleton.root
            bone = positions[:, j] - positions[:, parent]
            norm = np.maximum(np.linalg.norm(bone, axis=1, keepdims=True), 1e-9)
            standard[:, j] = standard[:, parent] + bone / norm * length
        return standard


def mean_of_known(values: Array) -> Array:
    """Return means over the first axis without NaN; NaN where all are."""
    return np.asarray(np.ma.masked_invalid(values).mean(axis=0).filled(np.nan))


def within_uncertainty(ratios: Array) -> tuple[float, float] | None:
    """Return percentages of known errors below 1 and 1.96 uncertainties, or None."""
    known = ratios[~np.isnan(ratios)]
    if not known.size:
        return None
    return float(np.mean(known < 1.0) * 100), float(np.mean(known < 1.96) * 100)


@dataclass(eq=False)
class _Person:
    """Results of a method on the clips of one person."""

    distances: list[Array] = field(default_factory=list)
    standardized: list[Array] = field(default_factory=list)
    varying: list[Array] = field(default_factory=list)
    hips: list[Array] = field(default_factory=list)
    jitters: list[float] = field(default_factory=list)
    ratios: list[Array] = field(default_factory=list)  # errors over uncertainties
    wrong: list[Flags] = field(default_factory=list)  # raw joints beyond ``FAR``
    moved: list[Array] = field(default_factory=list)  # how far, without offset [m]
    movements: list[str] = field(default_factory=list)
    misplaced: list[tuple[bool, bool]] = field(default_factory=list)
    """Whether a limb was misplaced, and whether a warning said so."""

    def figures(self) -> dict[str, float | None]:
        """Return means over frames and joints [cm, cm/s], and the jitter [m/s^3].

        ``found`` is the area under the ROC curve of how far a joint was moved, for
        wrong raw joints; for the others see ``within_uncertainty``.
        """
        distances = np.concatenate(self.distances)
        hips = mean_of_known(np.concatenate(self.hips)[:, None])[0]
        within = within_uncertainty(np.concatenate(self.ratios or [np.empty(0)]))
        wrong, moved = np.concatenate(self.wrong), np.concatenate(self.moved)
        return {
            "E": float(np.nanmean(distances) * 100),
            "E_std": float(np.nanmean(np.concatenate(self.standardized)) * 100),
            "E_var": float(np.nanmean(np.concatenate(self.varying)) * 100),
            "p95": float(np.nanpercentile(distances, 95) * 100),
            "hips": float(hips * 100) if np.isfinite(hips) else None,
            "jitter": float(np.nanmean(self.jitters)),
            "within_68": within[0] if within else None,
            "within_95": within[1] if within else None,
            "found": area_under_roc(wrong, moved),
        }


class Tally:
    """Results of a method over many clips."""

    def __init__(self, accuracy: Accuracy) -> None:
        self._accuracy = accuracy
        self._people: dict[str, _Person] = {}
        self._seconds, self._frames = 0.0, 0

    def add(
        self,
        pair: PairedTake,
        positions: Array,
        seconds: float,
        uncertainty: Array | None = None,
        *,
        warned: bool = False,
    ) -> None:
        """Add a clip of a raw take and its truth, cleaned in a time [s].

        Positions [m] have shape (T, J, 3), their uncertainty [m] has (T, J); ``warned``
        tells whether cleaning warned of displaced limbs.
        """
        person = self._people.setdefault(pair.subject, _Person())
        accuracy, truth = self._accuracy, pair.truth
        person.distances.append(accuracy.distances(positions, truth))
        person.standardized.append(accuracy.standardized(positions, truth))
        person.varying.append(accuracy.varying(positions, truth))
        person.hips.append(accuracy.hips(pair.take.time, positions, truth))
        person.movements.append(pair.movement)
        person.jitters.append(jitter(pair.take.time, positions[:, accuracy.limbs]))
        raw = accuracy.varying(pair.take.positions, truth)
        moved = accuracy.varying(positions, pair.take.positions)
        known = ~np.isnan(raw + moved)
        frames = max(round(_AVERAGED * pair.take.fps), 1)
        averaged = uniform_filter1d(np.nan_to_num(raw), frames, axis=0)
        person.misplaced.append((bool(averaged.max() > MISPLACED), warned))
        person.wrong.append(raw[known] > FAR)
        person.moved.append(moved[known])
        if uncertainty is not None:
            away = np.abs(accuracy.away(positions, truth))
            person.ratios.append(away / uncertainty[:, accuracy.limbs, None])
        self._seconds += seconds
        self._frames += len(positions)

    def extend(self, other: Self) -> None:
        """Add the clips of another tally."""
        for name, person in other._people.items():
            mine = self._people.setdefault(name, _Person())
            for field_name, values in vars(person).items():
                getattr(mine, field_name).extend(values)
        self._seconds += other._seconds
        self._frames += other._frames

    def by_movement(self) -> dict[str, dict[str, float]]:
        """Return E_var [cm] of each movement, by person."""
        errors: dict[str, dict[str, float]] = {}
        for name, person in self._people.items():
            clips = list(zip(person.movements, person.varying, strict=True))
            for movement in dict.fromkeys(person.movements):
                varying = np.concatenate([v for m, v in clips if m == movement])
                errors.setdefault(movement, {})[name] = float(np.nanmean(varying) * 100)
        return errors

    def summary(self) -> dict[str, Any]:
        """Return the figures: means over frames and joints, then over people."""
        people = {name: person.figures() for name, person in self._people.items()}
        means: dict[str, float | None] = {}
        for key in next(iter(people.values())):
            known = [x for each in people.values() if (x := each[key]) is not None]
            means[key] = float(np.mean(known)) if known else None
        each_joint = [
            mean_of_known(np.concatenate(person.distances)) * 100
            for person in self._people.values()
        ]
        joints = zip(LIMBS, mean_of_known(np.array(each_joint)), strict=True)
        clips = [clip for person in self._people.values() for clip in person.misplaced]
        return {
            **means,
            "ms_per_frame": self._seconds / self._frames * 1e3,
            "joints": {
                name: None if np.isnan(cm) else float(cm) for name, cm in joints
            },
            "clips_off": sum(off for off, _ in clips),
            "clips_off_told": sum(off and warned for off, warned in clips),
            "false_alarms": sum(warned and not off for off, warned in clips),
            "people": people,
            "movements": self.by_movement(),
        }


def area_under_roc(wrong: Flags, score: Array) -> float | None:
    """Return how well a score ranks what is wrong; None if all or nothing is."""
    from sklearn.metrics import roc_auc_score

    return float(roc_auc_score(wrong, score)) if 0.0 < wrong.mean() < 1.0 else None
