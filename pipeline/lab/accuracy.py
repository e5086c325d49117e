"""How far a motion is from the truth, as marker mocap or a simulation knows it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.metrics import jitter
from kinefilter.pipeline.pairs import PairedTake

LIMBS = tuple(
    part + side
    for part in ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
    for side in ("Left", "Right")
)
"""The joints that count: those whose place mocap and Kinect agree on in principle."""

FAR = 0.07
"""Joints farther off than this [m], constant offset aside, are to be found."""
MISPLACED = 0.12
"""Clips in which the mean of that over half a second is larger [m] are to be told."""
_WHILE = 0.5  # s


class Accuracy:
    """Distances of limb joints from the truth, relative to the middle of the hips.

    Args:
        skeleton: The joints.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self.limbs = [skeleton.index(joint) for joint in LIMBS]
        self._lengths = standard_body(skeleton).lengths

    def distances(self, positions: Array, truth: Array) -> Array:
        """Return E's distances [m] per frame and limb joint, NaN where none, (T, 12).

        Args:
            positions: Joint positions [m], shape (T, J, 3).
            truth: Of the same frames and in the same orientation, shape (T, J, 3).
        """
        return np.asarray(np.linalg.norm(self.away(positions, truth), axis=2))

    def standardized(self, positions: Array, truth: Array) -> Array:
        """Return E_std's: both sides' bones at standard lengths first, (T, 12)."""
        return self.distances(self._standard(positions), self._standard(truth))

    def varying(self, positions: Array, truth: Array) -> Array:
        """Return E_var's: without each joint's constant offset over the clip, (T, 12).

        What an animator sees as wrong motion.
        """
        away = self.away(positions, truth)
        seen = ~np.isnan(away[..., 0])
        counts = np.maximum(seen.sum(axis=0), 1)[:, None]
        mean = np.where(seen[..., None], away, 0.0).sum(axis=0) / counts
        return np.asarray(np.linalg.norm(away - mean, axis=2))

    def away(self, positions: Array, truth: Array) -> Array:
        """Return errors of limb joints [m], NaN where unknown, shape (T, 12, 3)."""
        return self._from_hips(positions) - self._from_hips(truth)

    def _from_hips(self, positions: Array) -> Array:
        middle = positions[:, self.skeleton.hips].mean(axis=1, keepdims=True)
        return np.asarray((positions - middle)[:, self.limbs])

    def _standard(self, positions: Array) -> Array:
        """Keep each bone's direction, give it the standard length.

        A joint on the way that is missing for the whole clip, such as mocap's spine,
        is passed over on both sides of the comparison alike: the trunk is one bone.
        """
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


def within_uncertainty(shares: Array) -> tuple[float, float] | None:
    """Return the per cent of coordinates within their uncertainty, and 1.96 times it.

    Args:
        shares: Sizes of errors over what the clip says they may be, NaN where unknown.
    """
    known = shares[~np.isnan(shares)]
    if not known.size:
        return None
    return float(np.mean(known < 1.0) * 100), float(np.mean(known < 1.96) * 100)


@dataclass(eq=False)
class _Person:
    """What a method did on the clips of one person."""

    distances: list[Array] = field(default_factory=list)
    standardized: list[Array] = field(default_factory=list)
    varying: list[Array] = field(default_factory=list)
    jitters: list[float] = field(default_factory=list)
    shares: list[Array] = field(default_factory=list)
    """Errors of coordinates, over what the clip says that they may be."""
    wrong: list[Flags] = field(default_factory=list)
    """Whether a raw joint is over 7 cm off, constant offset aside."""
    moved: list[Array] = field(default_factory=list)
    """How far such a joint was moved [m], likewise."""
    movements: list[str] = field(default_factory=list)
    """What each clip shows."""
    told: list[tuple[bool, bool]] = field(default_factory=list)
    """Whether a limb was off by 12 cm for half a second, and whether that was told."""

    def figures(self) -> dict[str, float | None]:
        """Return means over frames and joints [cm], and the jitter [m/s^3].

        ``within_68`` and ``within_95``: per cent of coordinates that are off by less
        than their uncertainty, and than 1.96 times as much. ``found``: area under the
        ROC curve of how far a joint was moved, for raw joints that were off.
        """
        distances = np.concatenate(self.distances)
        within = within_uncertainty(np.concatenate(self.shares or [np.empty(0)]))
        wrong, moved = np.concatenate(self.wrong), np.concatenate(self.moved)
        return {
            "E": float(np.nanmean(distances) * 100),
            "E_std": float(np.nanmean(np.concatenate(self.standardized)) * 100),
            "E_var": float(np.nanmean(np.concatenate(self.varying)) * 100),
            "p95": float(np.nanpercentile(distances, 95) * 100),
            "jitter": float(np.nanmean(self.jitters)),
            "within_68": within[0] if within else None,
            "within_95": within[1] if within else None,
            "found": area_under_roc(wrong, moved),
        }

    def per_joint(self) -> Array:
        """Return each limb joint's mean distance [cm], NaN where unknown, (12,)."""
        distances = np.concatenate(self.distances)
        counts = (~np.isnan(distances)).sum(axis=0)
        sums = np.nansum(distances, axis=0)
        mean = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
        return np.asarray(mean * 100)


class Tally:
    """Gathers what a method did.

    Args:
        accuracy: How far a motion is from the truth.
    """

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
        told: bool = False,
    ) -> None:
        """Add a clip.

        Args:
            pair: The clip and its truth.
            positions: What the method made of it [m], shape (T, J, 3).
            seconds: What that took.
            uncertainty: How far joints may be off [m], shape (T, J).
            told: Whether the user was told that limbs were displaced.
        """
        person = self._people.setdefault(pair.subject, _Person())
        accuracy, truth = self._accuracy, pair.truth
        person.distances.append(accuracy.distances(positions, truth))
        person.standardized.append(accuracy.standardized(positions, truth))
        person.varying.append(accuracy.varying(positions, truth))
        person.movements.append(pair.movement)
        person.jitters.append(jitter(pair.take.time, positions[:, accuracy.limbs]))
        off = accuracy.varying(pair.take.positions, truth)
        moved = accuracy.varying(positions, pair.take.positions)
        known = ~np.isnan(off + moved)
        frames = max(round(_WHILE * pair.take.fps), 1)
        lasting = uniform_filter1d(np.nan_to_num(off), frames, axis=0).max()
        person.told.append((bool(lasting > MISPLACED), told))
        person.wrong.append(off[known] > FAR)
        person.moved.append(moved[known])
        if uncertainty is not None:
            away = np.abs(accuracy.away(positions, truth))
            person.shares.append(away / uncertainty[:, accuracy.limbs, None])
        self._seconds += seconds
        self._frames += len(positions)

    def extend(self, other: Tally) -> None:
        """Add the clips of another tally."""
        for name, person in other._people.items():
            mine = self._people.setdefault(name, _Person())
            for field_name, values in vars(person).items():
                getattr(mine, field_name).extend(values)
        self._seconds += other._seconds
        self._frames += other._frames

    def by_movement(self) -> dict[tuple[str, str], float]:
        """Return E_var [cm] of each person's clips of each movement."""
        found = {}
        for name, person in self._people.items():
            clips = list(zip(person.movements, person.varying, strict=True))
            for movement in dict.fromkeys(person.movements):
                varying = np.concatenate([v for m, v in clips if m == movement])
                found[name, movement] = float(np.nanmean(varying) * 100)
        return found

    def summary(self) -> dict[str, Any]:
        """Return the figures: means over frames and joints, then over people."""
        each = {name: person.figures() for name, person in self._people.items()}
        mean = {
            key: float(np.mean(known)) if (known := _known(each, key)) else None
            for key in next(iter(each.values()))
        }
        joints = np.array([person.per_joint() for person in self._people.values()])
        told = [pair for person in self._people.values() for pair in person.told]
        seen = ~np.isnan(joints)
        means = np.nansum(joints, axis=0) / np.maximum(seen.sum(axis=0), 1)
        return {
            **mean,
            "ms_per_frame": self._seconds / self._frames * 1e3,
            "joints": {
                name: float(value) if ever else None
                for name, value, ever in zip(
                    LIMBS, means, seen.any(axis=0), strict=True
                )
            },
            "clips_off": sum(off for off, _ in told),
            "clips_off_told": sum(off and said for off, said in told),
            "false_alarms": sum(said and not off for off, said in told),
            "people": each,
            "movements": self._of_movements(),
        }

    def _of_movements(self) -> dict[str, dict[str, float]]:
        """Return E_var [cm] of each movement, by person."""
        found: dict[str, dict[str, float]] = {}
        for (name, movement), varying in self.by_movement().items():
            found.setdefault(movement, {})[name] = varying
        return found


def _known(people: dict[str, dict[str, float | None]], key: str) -> list[float]:
    return [value for figures in people.values() if (value := figures[key]) is not None]


def area_under_roc(wrong: Flags, score: Array) -> float | None:
    """Return how well a score tells what is wrong; None where all or nothing is."""
    from sklearn.metrics import roc_auc_score

    return float(roc_auc_score(wrong, score)) if 0.0 < wrong.mean() < 1.0 else None
