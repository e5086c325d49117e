"""Trains the forest that finds body parts in depth images, on simulated images.

``python -m kinefilter.pipeline.lab.teach_depth FOLDER OUT.npz`` rewrites
``scenes/sensor/embedded/body_parts.npz`` and prints the accuracy on people and subjects
who are not in the training data; FOLDER holds CMU's mocap (BVH). ``--help`` lists the
sizes. Half of the images show mocap and half scripted motions of simulated people.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from numpy.typing import NDArray

from kinefilter.characters import SKELETONS, Body, InputError, Skeleton, standard_body
from kinefilter.characters.anthropometry import positions_from_rotations
from kinefilter.characters.arrays import Array, Indices, Singles
from kinefilter.pipeline.database import filter_to_count
from kinefilter.pipeline.formats.mocap import read_mocap
from kinefilter.pipeline.workers import workers
from kinefilter.retarget import rotations_from_positions
from kinefilter.scenes.library import MOTIONS, perform, random_body
from kinefilter.scenes.sensor import SENSORS, in_sensor_frame
from kinefilter.scenes.sensor.depth_tracker import (
    BODY_PARTS,
    BodyPartForest,
    DepthCamera,
    DepthImage,
    depth_differences,
    joint_constants,
    nearest_joints,
    parts_of_joints,
    propose,
    push_behind_skin,
    with_noise,
)
from kinefilter.scenes.sensor.visibility import PosedBody

from .database_build import mocap_postures

_HELD_OUT = ("02", "08", "12", "29")  # CMU's subjects who are not in training data
_PEOPLE, _CHECKING, _TESTING = 5_000_000, 5_100_000, 5_200_000
"""First seeds of the people for the trees, for the joints' constants, and for tests."""
_CHECKED = 24  # people for the constants, and as many to test on
_FARTHEST, _NEAREST = 0.7, 0.015  # m: range of feature offsets
_RIGHT = 0.1  # m: a joint this close to the truth counts as found (Shotton et al.)
_FULL = 255.0


@dataclass(frozen=True)
class Sizes:
    """Size of the training data and of the forest."""

    people: int = 300
    """Number of simulated people."""
    images: int = 24
    """Number of images of each person."""
    pixels: int = 120
    """Number of pixels of each image."""
    features: int = 300
    """Number of depth differences to choose from."""
    trees: int = 3
    """Number of trees; the paper has three."""
    leaves: int = 15000
    """Maximum number of leaves per tree."""
    depth: int = 20
    """Maximum depth of a tree; the paper has 20."""


class Shot(NamedTuple):
    """An image of a person, and the true joint positions [m], in the sensor frame."""

    image: DepthImage
    joints: Array
    body: Body

    def labels(self, rows: Indices, columns: Indices) -> Indices:
        """Return the true body part of pixels, (N,)."""
        points = self.image.points(rows, columns)
        segments = self.image.segments[rows, columns]
        joints = nearest_joints(points, segments, self.joints, self.body)
        parts = np.argmax(parts_of_joints(self.body.skeleton), axis=0)
        return np.where(joints < 0, len(BODY_PARTS) - 1, parts[joints])


def mocap_rotations(folder: Path, skeleton: Skeleton, *, held_out: bool) -> Array:
    """Return rotations of diverse postures without yaw, (N, J, 4), or InputError."""
    files = [
        file
        for file in sorted(folder.glob("*.bvh*"))
        if (file.name.partition("_")[0] in _HELD_OUT) is held_out
    ]
    if not files:
        raise InputError(f"{folder}: no BVH of CMU's subjects; give their folder")
    postures = [mocap_postures(read_mocap(file), skeleton) for file in files]
    positions = np.concatenate(postures)
    kept = positions[filter_to_count(positions, 2000)]
    return rotations_from_positions(kept, standard_body(skeleton))


def shots_of(seed: int, count: int, mocap: dict[str, Array]) -> Iterator[Shot]:
    """Yield ``count`` images of a person, half of mocap and half of scripted motions.

    The seed determines the person, the motions, and the placement and noise of sensors.
    Postures are drawn from ``mocap``, segment rotations by the name of the skeleton.
    """
    rng = np.random.default_rng(seed)
    skeleton = SKELETONS[sorted(SKELETONS)[seed % len(SKELETONS)]]
    body = random_body(skeleton, rng)
    rows = rng.integers(len(mocap[skeleton.name]), size=count - count // 2)
    turns = [mocap[skeleton.name][rows]]
    for name in rng.choice(MOTIONS, 3):
        act = perform(str(name), body, seed=seed)
        turns.append(act.rotations[rng.integers(len(act), size=-(-count // 6))])
    rotations = np.concatenate(turns)[:count]
    root = np.zeros((len(rotations), 3))
    root[:, [0, 2]] = rng.normal(0.0, 0.3, (len(rotations), 2))
    positions = positions_from_rotations(rotations, root, body)
    positions[..., 1] -= (positions[..., 1] - body.radii).min(axis=1)[:, None]
    camera = DepthCamera(PosedBody(body), SENSORS["v2"])
    for joints, turn in zip(positions, rotations, strict=True):
        height, distance = rng.uniform(0.6, 1.6), rng.uniform(2.0, 3.6)
        sensor = SENSORS[str(rng.choice(list(SENSORS)))]
        azimuth = float(np.clip(rng.normal(0.0, 0.7), -1.7, 1.7))
        tilt = float(np.arctan2(0.9 - height, distance) + rng.normal(0.0, 0.08))
        sensor = replace(sensor, height=height, distance=distance)
        camera.look_from(replace(sensor, azimuth=azimuth, tilt=tilt))
        image = with_noise(camera.take(joints, turn), camera.sensor, rng)
        yield Shot(image, in_sensor_frame(joints, camera.sensor), body)


def features(count: int) -> Singles:
    """Return pairs u, v of log-uniform lengths, half with v = 0, (F, 2, 2)."""
    rng = np.random.default_rng(0)
    angle = rng.uniform(0.0, 2.0 * np.pi, (count, 2))
    size = np.exp(rng.uniform(np.log(_NEAREST), np.log(_FARTHEST), (count, 2)))
    size[::2, 1] = 0.0
    offsets = size[..., None] * np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    return np.asarray(offsets, dtype=np.float32)


def training_pixels(
    seed: int, sizes: Sizes, mocap: dict[str, Array]
) -> tuple[Singles, NDArray[np.int8]]:
    """Return features and parts of a person's pixels, more often of rare parts."""
    rng, offsets = np.random.default_rng([seed, 1]), features(sizes.features)
    values, parts = [], []
    for shot in shots_of(seed, sizes.images, mocap):
        rows, columns = np.nonzero(shot.image.segments >= 0)
        if len(rows) < sizes.pixels:
            continue
        labels = shot.labels(rows, columns)
        rare = 1.0 / np.sqrt(np.bincount(labels)[labels])
        some = rng.choice(len(rows), sizes.pixels, replace=False, p=rare / rare.sum())
        at = rows[some], columns[some]
        differences = [
            depth_differences(shot.image, *at, np.broadcast_to(o, (len(some), 2, 2)))
            for o in offsets
        ]
        values.append(np.stack(differences, axis=1))
        parts.append(labels[some].astype(np.int8))
    return np.concatenate(values), np.concatenate(parts)


def fitted(values: Singles, parts: NDArray[np.int8], sizes: Sizes) -> BodyPartForest:
    """Return a forest that classifies pixels; joints have no constants yet."""
    from sklearn.ensemble import RandomForestClassifier

    forest = RandomForestClassifier(
        sizes.trees,
        criterion="entropy",
        max_depth=sizes.depth,
        max_leaf_nodes=sizes.leaves,
        min_samples_leaf=4,
        max_samples=0.8,
        n_jobs=2,
        random_state=0,
    )
    forest.fit(values, parts)
    return converted(forest.estimators_, forest.classes_, features(sizes.features))


def converted(
    trees: Sequence[object], classes: NDArray[np.int8], offsets: Singles
) -> BodyPartForest:
    """Return scikit-learn's trees as arrays; joints have no constants yet."""
    roots, feature, threshold, children, leaves = [], [], [], [], []
    nodes = kept = 0
    for tree in (getattr(tree, "tree_") for tree in trees):  # noqa: B009
        leaf = tree.children_left < 0
        row = np.cumsum(leaf) - 1 + kept
        roots.append(nodes)
        feature.append(np.where(leaf, -1, tree.feature))
        # Rounding down to single precision sends the same pixels to the left.
        limit = tree.threshold.astype(np.float32)
        beyond = np.nextafter(limit, np.float32(-np.inf))
        threshold.append(np.where(limit > tree.threshold, beyond, limit))
        both = np.stack([tree.children_left, tree.children_right], axis=1) + nodes
        children.append(np.where(leaf[:, None], row[:, None], both))
        share = np.zeros((int(leaf.sum()), len(BODY_PARTS)))
        share[:, classes] = tree.value[leaf, 0]
        leaves.append(np.rint(_FULL * share / share.sum(axis=1, keepdims=True)))
        nodes, kept = nodes + len(leaf), kept + len(share)
    zeros = np.zeros((len(SKELETONS), len(BODY_PARTS)), dtype=np.float32)
    return BodyPartForest(
        offsets,
        np.array(roots, dtype=np.int32),
        np.concatenate(feature).astype(np.int16),
        np.concatenate(threshold).astype(np.float32),
        np.concatenate(children).astype(np.int32),
        np.concatenate(leaves).astype(np.uint8),
        zeros,
        zeros,
    )


class Results(NamedTuple):
    """A forest's results on the images of one person."""

    skeleton: Skeleton
    skin: Array  # positions from ``propose`` [m], (N, J, 3)
    area: Array  # areas from ``propose`` [m^2], (N, J)
    joints: Array  # true joint positions [m], (N, J, 3)
    hits: tuple[int, int]  # number of correctly classified pixels, and of all pixels


def evaluate_forest(
    seed: int, count: int, mocap: dict[str, Array], forest: BodyPartForest
) -> Results:
    """Return a forest's results on ``count`` images of a person."""
    skin, area, joints, right, whole = [], [], [], 0, 0
    for shot in shots_of(seed, count, mocap):
        proposals = propose(shot.image, forest, shot.body.skeleton)
        skin.append(proposals.skin)
        area.append(proposals.area)
        joints.append(shot.joints)
        rows, columns = (at[::7] for at in np.nonzero(shot.image.segments >= 0))
        parts = forest.shares(shot.image, rows, columns).argmax(axis=1)
        right += int((parts == shot.labels(rows, columns)).sum())
        whole += len(rows)
    arrays = np.array(skin), np.array(area), np.array(joints)
    return Results(shot.body.skeleton, *arrays, (right, whole))


def _by_skeleton(
    results: Sequence[Results],
) -> Iterator[tuple[int, Skeleton, Array, Array, Array]]:
    """Yield row, skeleton, skin, area and joints of each skeleton with results."""
    for row, skeleton in enumerate(SKELETONS.values()):
        own = [one for one in results if one.skeleton == skeleton]
        if own:
            skin, area, joints = (
                np.concatenate([getattr(one, name) for one in own])
                for name in ("skin", "area", "joints")
            )
            yield row, skeleton, skin, area, joints


def with_constants(forest: BodyPartForest, tested: Sequence[Results]) -> BodyPartForest:
    """Return the forest with joints' depth behind the skin and least decisive area."""
    push, least = forest.push.copy(), forest.least.copy()
    for row, skeleton, skin, area, joints in _by_skeleton(tested):
        line = skin / np.linalg.norm(skin, axis=-1, keepdims=True)
        depth = np.vecdot(joints - skin, line)
        for j, part in enumerate(np.argmax(parts_of_joints(skeleton), axis=0)):
            much = area[:, j] > np.nanmedian(area[:, j])
            push[row, part] = np.nanmedian(depth[much, j])
            placed = push_behind_skin(skin[:, j], push[row, part])
            away = np.linalg.norm(placed - joints[:, j], axis=-1)
            right = np.nan_to_num(away, nan=np.inf) < _RIGHT
            order = np.argsort(area[:, j])
            # Cost of a minimum at the k-th area: good joints lost minus bad ones lost.
            cost = np.cumsum(np.where(right[order], 1, -1))
            k = int(np.argmin(np.append(0, cost)))
            least[row, part] = np.append(area[order, j], np.inf)[k]
    return replace(forest, push=push, least=least)


def report(forest: BodyPartForest, tested: Sequence[Results]) -> Iterator[str]:
    """Yield the accuracy of a forest, measured on held-out images."""
    right, whole = np.sum([result.hits for result in tested], axis=0)
    yield f"pixels classified correctly: {right / whole:.0%} of {whole}"
    for _, skeleton, skin, area, joints in _by_skeleton(tested):
        push, least = joint_constants(forest, skeleton)
        away = 100.0 * np.linalg.norm(push_behind_skin(skin, push) - joints, axis=-1)
        tracked = area >= least
        yield f"{skeleton.name}: joint, tracked %, median cm, within 10 cm %"
        for j, name in enumerate(skeleton.joints):
            errors, share = away[tracked[:, j], j], 100.0 * tracked[:, j].mean()
            if errors.size:
                good = 100.0 * np.mean(errors < 100.0 * _RIGHT)
                yield f"  {name:14} {share:4.0f} {np.median(errors):5.1f} {good:4.0f}"


def teach_depth(
    folder: Path, out: Path, sizes: Sizes, *, checked: int = _CHECKED
) -> Iterator[str]:
    """Train a forest on CMU's mocap (BVH), write it (.npz), and yield its accuracy.

    ``checked`` people determine the constants of joints, and as many are tested on.
    Raises an InputError if the mocap for training or for testing is missing.
    """
    mocap, other = (
        {s.name: mocap_rotations(folder, s, held_out=held) for s in SKELETONS.values()}
        for held in (False, True)
    )
    with workers() as pool:
        draw = partial(training_pixels, sizes=sizes, mocap=mocap)
        pixels = [*pool.map(draw, range(_PEOPLE, _PEOPLE + sizes.people))]
        values, parts = (np.concatenate(part) for part in zip(*pixels, strict=True))
        yield f"training on {len(values)} pixels"
        forest = fitted(values, parts, sizes)
        check = partial(evaluate_forest, count=sizes.images, mocap=mocap, forest=forest)
        results = [*pool.map(check, range(_CHECKING, _CHECKING + checked))]
        forest = with_constants(forest, results)
        forest.save(out)
        test = partial(evaluate_forest, count=sizes.images, mocap=other, forest=forest)
        results = [*pool.map(test, range(_TESTING, _TESTING + checked))]
        yield from report(forest, results)


def main(
    folder: tyro.conf.Positional[Path],
    out: tyro.conf.Positional[Path],
    sizes: tyro.conf.OmitArgPrefixes[Sizes] = Sizes(),
) -> None:
    """Train the forest of body parts on CMU's mocap, and write it (.npz)."""
    for line in teach_depth(folder, out, sizes):
        print(line, flush=True)


if __name__ == "__main__":
    tyro.cli(main)
