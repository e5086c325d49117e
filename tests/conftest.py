from __future__ import annotations

import os
import signal

# The suite runs on all cores; more threads of linear algebra would only fight.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")  # scikit-learn's
# Some containers set it; each command that a test starts would compile everything.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from browser import Browser, missing
from numpy.typing import NDArray
from short_takes import write_short_sample

from kinefilter.characters import (
    KINECT_V1,
    SKELETONS,
    Body,
    Clip,
    Prop,
    Shape,
    ShapeKind,
    Skeleton,
    Term,
    standard_body,
)

MakeClip = Callable[..., Clip]

BODIES = {skeleton.name: standard_body(skeleton) for skeleton in SKELETONS.values()}


def _smooth_rotations(
    time: NDArray[np.float64], joints: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Swing every joint through up to a full turn, shape (T, J, 4)."""
    pace = rng.uniform(0.1, 2.0, (joints, 3))
    phase = rng.uniform(0.0, 6.0, (joints, 3))
    vectors = 3.0 * np.sin(time[:, None, None] * pace + phase)
    angles = np.linalg.norm(vectors, axis=-1, keepdims=True)
    axes = vectors / np.maximum(angles, 1e-12)
    return np.concatenate([np.cos(angles / 2), np.sin(angles / 2) * axes], axis=-1)


def _wild_rotations(
    frames: int, joints: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Mix random turns with quarter and half turns about the axes, (T, J, 4)."""
    corners = np.array([q for q in product((-1.0, 0.0, 1.0), repeat=4) if any(q)])
    quaternions = rng.normal(size=(frames, joints, 4))
    special = corners[rng.integers(len(corners), size=(frames, joints))]
    quaternions = np.where(rng.random((frames, joints, 1)) < 0.5, special, quaternions)
    return quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)


def _thing(
    kind: ShapeKind, positions: NDArray[np.float64], rotations: NDArray[np.float64]
) -> Prop:
    """Return a prop called after the kind of its two shapes."""
    mesh = kind == "mesh"
    points = np.array([[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3], [-0.1, -0.2, -0.3]])
    triangles = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]])
    shapes = [
        Shape(
            kind,
            np.array([0.1, 0.2, 0.1]),
            np.array([0.0, height, 0.0]),
            np.array([0.6, 0.0, 0.8, 0.0]),
            np.array([0.8, 0.4, 0.1]),
            points if mesh else np.empty((0, 3)),
            triangles if mesh else np.empty((0, 3), dtype=np.int64),
        )
        for height in (0.0, 0.5)
    ]
    return Prop(f"the {kind}", tuple(shapes), positions, rotations)


@pytest.fixture(scope="session")
def furnish() -> Callable[[Clip], Clip]:
    """Return what puts a prop of each kind beside a clip, the first two moving."""

    def furnished(clip: Clip) -> Clip:
        time = clip.time - clip.time[0]
        path = np.stack([time, 1.0 + np.sin(time), -time], axis=1)
        zero = np.zeros_like(time)
        turns = np.stack([np.cos(time), np.sin(time), zero, zero], axis=1)
        props = [
            _thing(kind, path[frames] + n, turns[frames])
            for n, kind in enumerate(get_args(ShapeKind))
            for frames in [slice(None if n < 2 else 1)]
        ]
        return replace(clip, props=tuple(props))

    return furnished


@pytest.fixture(scope="session")
def make_clip() -> MakeClip:
    """Return a maker of clips whose positions follow from random rotations."""

    def make(
        frames: int = 40,
        skeleton: Skeleton = KINECT_V1,
        *,
        seed: int = 0,
        wild: bool = False,
        time: NDArray[np.float64] | None = None,
        body: Body | None = None,
    ) -> Clip:
        rng = np.random.default_rng(seed)
        if time is None:
            time = np.arange(frames) / 30.0
        joints, body = len(skeleton), body or BODIES[skeleton.name]
        if wild:
            rotations = _wild_rotations(len(time), joints, rng)
        else:
            rotations = _smooth_rotations(time, joints, rng)
        root = np.stack(
            [np.sin(time), 0.9 + 0.1 * np.cos(time), 2.0 + np.cos(time / 3)], axis=-1
        )
        shape = (len(time), joints)
        moved = rng.random(shape)
        moved[0, 0] = np.nan
        return Clip(
            time=time,
            root=root,
            rotations=rotations,
            body=body,
            state=rng.integers(1, 3, shape).astype(np.uint8),
            reliability=rng.random(shape),
            deciding_term=rng.integers(len(Term), size=shape).astype(np.uint8),
            origin=rng.integers(0, 3, shape).astype(np.uint8),
            moved_by_correction=moved,
            moved_by_physics=rng.random(shape),
            uncertainty=moved,
            contacts=rng.random((len(time), 4)) < 0.5,
            external_force=rng.random(len(time)),
            source="made up",
        )

    return make


@pytest.fixture(scope="module")
def browser(request: pytest.FixtureRequest) -> Iterator[Browser]:
    """Open a window of Chromium as the module's WINDOW has it, where there is one."""
    reason = missing()
    if reason is not None:
        pytest.skip(reason)
    with Browser(**getattr(request.module, "WINDOW", {})) as opened:
        yield opened


@pytest.fixture(scope="module")
def few_for_kernels() -> Iterator[None]:
    """Fit hyper-parameters to fewer samples: most of the time that fitting takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("kinefilter.pipeline.lab.methods.local_models._FOR_KERNEL", 120)
        yield


@pytest.fixture
def brief_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let ``bench`` time a few of the sample's frames, on one core."""
    brief = write_short_sample(tmp_path / "brief", 39)
    monkeypatch.setattr("kinefilter.pipeline.lab.bench.SAMPLE", brief)
    monkeypatch.setattr("kinefilter.pipeline.lab.bench._TAKES_PER_CORE", 1)
    monkeypatch.setattr("kinefilter.pipeline.lab.bench.cores", lambda: 1)


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Let SIGINT interrupt, as it does unless a script began pytest with `&`."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def usd_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let USD be read in the process of the test: starting another takes a second."""
    from kinefilter.pipeline.formats import clips, usd_reader

    def read(reader: str, path: Path) -> dict[str, NDArray[Any]]:
        arrays = getattr(usd_reader, reader)(os.fspath(path))
        return {name: np.asarray(array) for name, array in arrays.items()}

    monkeypatch.setattr(clips, "read_usd", read)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let batches of the test work in its own process."""
    from batch_takes import Here

    monkeypatch.setattr("kinefilter.pipeline.batch.run.open_crew", Here)


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    """Return a folder of takes and other files, for a batch."""
    from batch_folders import make_folder

    return make_folder(tmp_path / "takes")
