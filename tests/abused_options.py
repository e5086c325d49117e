"""Random options of every command, by the types that they are declared with."""

from __future__ import annotations

import asyncio
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import MISSING, fields, is_dataclass
from functools import cache, partial
from importlib import import_module
from pkgutil import walk_packages
from threading import Timer
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints
from unittest import mock

from abused_commands import Attempt
from batch_takes import Here
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from tyro.conf import Positional, Suppress

import kinefilter
from kinefilter.pipeline.batch import run as batch_run
from kinefilter.pipeline.cli import _command
from kinefilter.pipeline.commands import live
from kinefilter.pipeline.lab import bench, database_build, simulation, studies, training
from kinefilter.pipeline.lab.commands.learn import DatabaseBuild, DatabaseInfo
from kinefilter.pipeline.look.player import Player
from kinefilter.pipeline.look.viewer import Viewer
from kinefilter.pipeline.methods import METHODS
from kinefilter.retarget.rig_map import RIGS
from kinefilter.scenes.library import MOTIONS

# Hypothesis also draws constants of the modules that are loaded: always the same ones.
for module in walk_packages(kinefilter.__path__, "kinefilter."):
    import_module(module.name)

Strategy = st.SearchStrategy[list[str]]

_WEIGHTS = {"clean": 12, "report": 4} | {
    name: weight
    for weight, names in (
        (3, ("info", "character", "batch")),
        (2, ("replay", "live", "merge", "train", "evaluate", "simulate")),
        (2, ("database build", "rate", "ratings")),
        (1, ("play", "view", "render", "pair", "reproduce", "bench", "blender")),
        (1, ("database info",)),
    )
    for name in names
}
_MOST = 4  # options that may be left out
_QUICK = ("reliability", "failures", "shum-table-3", "shum-figure-8", "chiang-figure-5")
_NUMBERS = ("0", "1", "0.5", "1.8", "6", "24", "30", "-1", "1e-9", "1e9", "nan", "inf")
_COUNTS = ("1", "2", "3", "0", "-1", "1000000000")
_POSITIONAL = get_args(Positional[int])[1]
_SUPPRESSED = get_args(Suppress[int])[1]
_TAKES = (
    *("{take.csv}", "{kinefilter.csv}", "{kinect-v1.csv}", "{kinect-v2.csv}"),
    *("{msrc-12.csv}", "{msr-action3d.txt}", "{ntu.skeleton}", "{azure.json}"),
    *("{zipped.csv}", "{clip.bvh}", "{take.csv}", "{take.csv}", "{mediapipe.npy}"),
)
_CLIPS = tuple(
    f"{{clip.{suffix}}}" for suffix in ("npz", "bvh", "usda", "usdc", "usdz", "glb")
)
_WRONG = ("{valid}", "absent", "{rig.toml}", "")
_SCENES = ("basic", "box", "chair", "basketball", "flip_chart", "office", "{own.xml}")
_USED = {
    "take": _TAKES,
    "view motion": _TAKES,
    "pair files": ("{take.csv}", "{kinect-v2.csv}", "{clip.bvh}", "{points.trc}"),
    "inputs": (*_TAKES, "{valid}"),
    "takes": (*("{front.csv}", "{side.csv}") * 4, *_TAKES),
    "clean takes": (*_TAKES, *_TAKES, "{front.csv}", "{side.csv}"),
    "calibration": ("{calibration.json}",),
    "batch sensors": ("front", "side", "take"),
    "sessions": ("{name}/{sensor}.csv", "{sensor}/{name}.csv", "{name}{sensor}.*"),
    "file": (*_TAKES, *_CLIPS, "{contacts.csv}", "{database.npz}", "{model.npz}"),
    **dict.fromkeys(("clip", "clips", "reference"), (*_CLIPS, "{take.csv}")),
    "systems": (*_CLIPS, "raw={take.csv}", "a={clip.npz}", "b={clip.bvh}", "={valid}"),
    "answers": ("{answers.json}", "{answers.json}", "{page.key.json}"),
    "key": ("{page.key.json}", "{page.key.json}", "{answers.json}"),
    "repeats": ("0", "2", "-1", "1000000000"),
    "compare": _TAKES,
    "same_person": _TAKES,
    **dict.fromkeys(("pairs", "train", "test"), ("{people.npz}", "{pairs.npz}")),
    "files": ("{pairs.npz}", "{clip.bvh}", "{points.c3d}", "{arm.amc}", "{arm.asf}"),
    "model": ("{model.npz}",),
    "person": ("s1", "nobody"),
    "database": ("{database.npz}",),
    "contacts": ("{contacts.csv}", "{clip.npz}"),
    "edits": ("{edits.toml}", "{options.toml}"),
    "scene": _SCENES,
    "config_file": ("{options.toml}",),
    "character": ("{out}/layer.usda", "{layered.usda}"),
    "rig": (*RIGS, "{rig.toml}"),
    "target": ("{mixamo.bvh}", "{mixamo.usda}", "{clip.usdz}"),
    "camera": ("front", "side", "orbit", "follow", "{camera.toml}"),
    "size": ("64x36", "32x32", "1x1", "2x2", "64", "0x0", "99999999x1"),
    "fail_on": ("skate>0.003", "jitter > 100", "nothing>1", "skate"),
    "cutoff": ("0", "0.5", "6", "30", "1000"),
    "height": ("1.2", "1.75", "2.1", "0.1", "9"),
    "mass": ("20", "75", "150", "0", "1e6"),
    "tilt": ("0", "10", "-30", "89.9", "90"),
    "floor": ("auto", "none", "0", "-0.8", "100"),
    "seed": ("0", "7", "-1", "99999999999999999999"),
    "motion": tuple(MOTIONS),
    "methods": (*METHODS, "none,default", "kalman,butterworth", "none", "nothing"),
    "set": ("neighbors=7", "steps=2", "style=0", "neighbors=0", "=", "rate_frames=x"),
    "presets": ("shum-2012", "wang-low-rank,shum-2012", "wang-low-rank:growth=2", "x"),
    "hide": ("left-arm", "arms", "shins", "left-hand", "tail"),
    "gap": ("55%", "0.2", "5%", "200%", "x"),
    "count": ("20", "2", "1", "10000000"),
    "speed": ("1000", "1e9", "50", "0", "nan", "inf"),
    "sources": (
        *("-", "-", "udp://127.0.0.1:0", "ws://127.0.0.1:0", "udp://h:99999", "x"),
    ),
    "bind": ("127.0.0.1", "127.0.0.1", "127.0.0.2", "192.0.2.1", "x y"),
    "port": ("0", "0", "-1", "65536"),
    "origin": ("https://studio.example", "x"),
    "scheduler": ("{dask}", "{dask}", "{dask}", "tcp://127.0.0.1:1", "x"),
    "views": ("{sessions}", "{sessions}/x_90deg_wave", "{valid}"),
    "sync": ("{sessions}/x_90deg_wave.sync.csv", "{take.csv}"),
    "studies": (*_QUICK, *_QUICK, "nothing"),
    "data": ("{recordings}", "{recordings}", "{valid}", "absent"),
    "bodies": ("1", "6", "0", "99"),
    "start": ("0", "0.1", "0.3", "99"),
    "to": ("0.2", "0.4", "0", "99"),
    "jobs": ("1", "1", "2", "0"),
}
_WRITTEN = {
    "clean": [
        f"o.{suffix}"
        for suffix in ("usda", "usdc", "usd", "usdz", "glb", "bvh", "csv", "npz", "txt")
    ],
    "batch": ["clips"],
    "render": ["o.mp4", "o.gif", "o%05d.png", "{clip}.mp4", "o.png"],
    "report": ["o.html"],
    "rate": ["o.html"],
    "character": ["o.xml"],
    "blender": ["o.zip"],
    "simulate": ["o.csv"],
    "merge": ["o.csv"],
    "live": ["-"],
    "reproduce": ["figures", "figures/quick"],
    "replay": ["udp://127.0.0.1:9", "-", "ws://127.0.0.1:1", "vmc://127.0.0.1:1"],
}
_ALSO_WRITTEN = {
    "all": "{out}/all",
    "json": "{out}/o.json",
    "pairs": "{out}/pairs.npz",  # of simulate
    "picture": "{out}/o.png",
    "report": "{out}/o.html",
    "save_contacts": "{out}/contacts.csv",
    "save_calibration": "{out}/o.json",
    "record": "{out}/o.csv",
    "truth": "{out}/truth.csv",
}
_READ = {("info", "json"), ("train", "pairs"), ("evaluate", "pairs")}
# Without these, studies and methods that learn take minutes.
_NEEDED = {("reproduce", "quick"), ("reproduce", "data"), ("evaluate", "methods")}
_EVERY_OTHER = {("batch", "scheduler"), ("train", "method"), ("evaluate", "test")}
# Instead of what has a place; evaluate has that with this option alone.
_INSTEAD = {
    "train": "--simulated",
    "database build": "--scripted",
    "reproduce": "--all",
    "evaluate": "--hide",
}
_OUT_OF_ALL = ("reproduce", "--out")
_FLAGS = {"start": "from", "config_file": "config", "sources": "in"}
_ENDED_AFTER = 0.5  # s; what would otherwise go on until Ctrl-C
_ODD = st.characters(exclude_categories=["Cs"], exclude_characters="/\0{}")


def abuse_options(attempt: Attempt) -> None:
    """Run a command with random options.

    Raises InputError where it is refused, and LostError or whatever went wrong.
    """
    name, words = drawn(attempt.rng.getrandbits(64))
    attempt.what = name
    here = attempt.folder / "in"
    here.mkdir()
    if name == "batch":
        for take in (*attempt.rng.sample(_TAKES[:9], 3), "{front.csv}", "{side.csv}"):
            shutil.copy(attempt.files[take[1:-1]], here)
    places = {"valid": here, "dask": _cluster() if "{dask}" in words else here}
    words = [attempt.filled(word, **places) for word in words]
    os.chdir(here)
    before = os.dup(0)
    with attempt.files["frames.jsonl"].open("rb") as frames:  # for live
        os.dup2(frames.fileno(), 0)
    try:
        with _small_and_ended(alone="--scheduler" not in words):
            attempt.run(words)
    finally:
        os.dup2(before, 0)
        os.close(before)


def drawn(number: int) -> tuple[str, list[str]]:
    """Return a command and its words, the same for the same number."""
    found = []

    # The first is always the simplest there is.
    @seed(number)
    @settings(
        max_examples=2,
        phases=[Phase.generate],
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(commands())
    def draw(command: tuple[str, list[str]]) -> None:
        found.append(command)

    draw()
    return found[-1]


def commands() -> st.SearchStrategy[tuple[str, list[str]]]:
    """Return a strategy of commands: the name and the words of the command line."""
    names = [name for name, weight in _WEIGHTS.items() for _ in range(weight)]
    return st.sampled_from(names).flatmap(
        lambda name: st.tuples(st.just(name), _words(name))
    )


@cache
def _words(name: str) -> Strategy:
    """Return a strategy of command lines of a command."""
    kinds = {"database build": DatabaseBuild, "database info": DatabaseInfo}
    placed, needed, others = [], [], []
    for field, hint, bare in _options(kinds.get(name) or _command(name)):
        if _POSITIONAL in getattr(hint, "__metadata__", ()):
            placed.append(_values(name, field, hint))
        elif bare or (name, field) in _NEEDED:
            needed.append(_option(name, field, hint))
        elif (name, field) in _EVERY_OTHER:
            needed.append(st.just([]) | _option(name, field, hint))
        else:
            others.append(_option(name, field, hint))
    if not others:
        some = st.just([])
    else:
        which = st.sets(st.integers(0, len(others) - 1), max_size=_MOST)
        some = which.flatmap(lambda them: st.tuples(*(others[k] for k in sorted(them))))
    # Those with a place first: an option may take however many words follow.
    parts = st.tuples(st.tuples(*placed), st.tuples(*needed), some)
    return st.tuples(st.booleans(), parts).map(
        lambda drawn: [
            *name.split(),
            *(word for words in _fitting(name, *drawn) for word in words),
        ]
    )


def _fitting(name: str, fit: bool, parts: Any) -> list[list[str]]:
    """Return the options of a command, if asked without those that exclude others."""
    placed, needed, some = parts
    given = {words[0] for words in (*needed, *some) if words}
    if fit and (name in _INSTEAD and _INSTEAD[name] in given) == (name != "evaluate"):
        placed = ()
        needed = [words for words in needed if (name, *words[:1]) != _OUT_OF_ALL]
    return [*placed, *needed, *some]


def _option(name: str, field: str, hint: Any) -> Strategy:
    """Return a strategy of an option and the words after it."""
    flag = _FLAGS.get(field, field).replace("_", "-")
    if (name, field) == ("reproduce", "quick"):
        return st.just(["--quick"])
    if hint is bool:
        return st.sampled_from([[f"--{flag}"], [f"--{flag}"], [f"--no-{flag}"]])
    words = _values(name, field, hint)
    if field in ("sources", "take"):  # each by a flag of its own
        return words.map(
            lambda given: [w for word in given for w in (f"--{flag}", word)]
        )
    return words.map(lambda given: [f"--{flag}", *given])


def _options(kind: Any) -> Iterator[tuple[str, Any, bool]]:
    """Yield name, type and whether it is needed, for all options of a command."""
    hints = get_type_hints(kind, include_extras=True)
    for field in fields(kind):
        hint = hints[field.name]
        inner = get_args(hint)[0] if get_origin(hint) is Annotated else hint
        if is_dataclass(inner):
            yield from _options(inner)
        elif _SUPPRESSED not in getattr(hint, "__metadata__", ()):
            bare = field.default is MISSING and field.default_factory is MISSING
            yield field.name, hint, bare


def _values(name: str, field: str, hint: Any) -> Strategy:
    """Return a strategy of the words of an option."""
    if field == "out":
        written = _WRITTEN.get(name, ["o.npz"])
        if name in ("live", "replay"):
            return st.sampled_from([[word] for word in written])
        odd = st.text(_ODD, min_size=1, max_size=99).map(lambda text: f"o{text}")
        known = st.sampled_from([f"{{out}}/{word}" for word in written])
        if name in ("batch", "reproduce", "render"):
            return st.tuples(known).map(list)
        suffix = st.sampled_from([f".{word.partition('.')[2]}" for word in written])
        return _mostly(
            known, st.tuples(odd, suffix).map(lambda two: f"{{out}}/{two[0]}{two[1]}")
        ).map(lambda word: [word])
    if field in _ALSO_WRITTEN and (name, field) not in _READ:
        return st.just([_ALSO_WRITTEN[field]])
    kinds, several = [hint], False
    while get_origin(kinds[0]) in (Annotated, Union, UnionType, tuple):
        several |= get_origin(kinds[0]) is tuple
        first = get_args(kinds[0])
        kinds = [*first] if get_origin(kinds[0]) in (Union, UnionType) else [first[0]]
        kinds = [kind for kind in kinds if kind is not type(None)]
    used = f"{name} {field}" if f"{name} {field}" in _USED else field
    word = st.one_of([_word(used, kind) for kind in kinds])
    several &= field not in ("fail_on", "origin")  # which are given again instead
    return st.lists(word, min_size=1, max_size=1 + several)


def _word(field: str, kind: Any) -> st.SearchStrategy[str]:
    """Return a strategy of words of a type."""
    if get_origin(kind) is Literal:
        return st.sampled_from([str(word) for word in get_args(kind)])
    wild: st.SearchStrategy[str]
    if kind is int:
        wild = st.sampled_from(_COUNTS) | st.integers().map(str)
    elif kind is float:
        wild = st.sampled_from(_NUMBERS) | st.floats().map(str)
    else:
        odd = st.text(_ODD, max_size=300).map(lambda text: f"{{valid}}/x{text}")
        wild = st.sampled_from(_WRONG) | odd
    return _mostly(st.sampled_from(_USED[field]), wild) if field in _USED else wild


def _mostly(
    known: st.SearchStrategy[str], wild: st.SearchStrategy[str]
) -> st.SearchStrategy[str]:
    return st.integers(0, 15).flatmap(lambda k: wild if k == 15 else known)


@contextmanager
def _small_and_ended(*, alone: bool) -> Iterator[None]:
    """Let what takes minutes be small, and what never ends be ended soon.

    Args:
        alone: Batches clean in this process.
    """
    stopped = live.stopped_by_signals

    def ended(run: Any) -> Any:
        def shown(page: Any) -> None:
            Timer(_ENDED_AFTER, page.stop).start()
            run(page)

        return shown

    @contextmanager
    def soon(stop: asyncio.Event) -> Iterator[None]:
        asyncio.get_running_loop().call_later(_ENDED_AFTER, stop.set)
        with stopped(stop):
            yield

    quick = {name: studies.STUDIES[name] for name in _QUICK}
    changes: Sequence[tuple[Any, str, Any]] = (
        *((page, "run", ended(page.run)) for page in (Player, Viewer)),
        (live, "stopped_by_signals", soon),
        *(
            (simulation, name, partial(getattr(simulation, name), people=2))
            for name in ("simulated_pairs", "pairs_with_props")
        ),
        (database_build, "MOTIONS", MOTIONS[:2]),
        (training, "_SIMULATED", 2),
        (bench, "_TAKES_PER_CORE", 1),
        (studies.study, "make_pictures", lambda *_, **__: ()),
        *(((batch_run, "open_crew", Here),) if alone else ()),
    )
    with ExitStack() as stack:
        for place, name, value in changes:
            stack.enter_context(mock.patch.object(place, name, value))
        stack.enter_context(mock.patch.dict(studies.STUDIES, quick, clear=True))
        stack.enter_context(mock.patch("webbrowser.open"))
        yield


@cache
def _cluster() -> str:
    """Return the address of a Dask cluster of one worker, which ends with us."""
    from distributed import LocalCluster

    cluster = LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0")
    return str(cluster.scheduler_address)
