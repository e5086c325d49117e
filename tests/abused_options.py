"""Random options of every command, by the types that they are declared with."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints
from unittest import mock

from abused_commands import Attempt
from batch_takes import Here
from tyro.conf import Positional

from kinefilter.pipeline.cli import _command
from kinefilter.pipeline.commands.learn import DatabaseBuild, DatabaseInfo
from kinefilter.pipeline.methods import METHODS
from kinefilter.retarget.rig_map import RIGS
from kinefilter.scenes.library import MOTIONS

_POSITIONAL = get_args(Positional[int])[1]
_WEIGHTS = {
    "clean": 12,
    "info": 3,
    "report": 4,
    "character": 3,
    "replay": 2,
    "live": 2,
    "render": 0.2,
    "batch": 2,
    "pair": 1,
    "train": 1,
    "evaluate": 2,
    "simulate": 2,
    "database build": 2,
    "database info": 1,
}
_OFTEN = 0.12  # of the time, an option that may be left out is given
_NUMBERS = ("0", "1", "0.5", "1.8", "6", "24", "30", "-1", "1e-9", "1e9", "nan", "inf")
_COUNTS = ("1", "2", "3", "0", "-1", "1000000000")
_TAKES = (
    *("{take.csv}", "{kinefilter.csv}", "{kinect-v1.csv}", "{kinect-v2.csv}"),
    *("{msrc-12.csv}", "{msr-action3d.txt}", "{ntu.skeleton}", "{azure.json}"),
    *("{zipped.csv}", "{clip.bvh}", "{take.csv}", "{take.csv}"),
)
_CLIPS = tuple(
    f"{{clip.{suffix}}}" for suffix in ("npz", "bvh", "usda", "usdc", "usdz", "npz")
)
_WRONG = ("{valid}", "absent", "{rig.toml}", "")
_SCENES = ("basic", "box", "chair", "basketball", "flip_chart", "office", "{own.xml}")
_USED = {
    "take": _TAKES,
    "inputs": (*_TAKES, "{valid}"),
    "file": (*_TAKES, *_CLIPS, "{contacts.csv}", "{database.npz}", "{model.npz}"),
    "clip": (*_CLIPS, "{take.csv}"),
    "clips": (*_CLIPS, "{take.csv}"),
    "compare": _TAKES,
    "same_person": _TAKES,
    "pairs": ("{pairs.npz}", "{people.npz}"),
    "train": ("{pairs.npz}", "{people.npz}"),
    "test": ("{pairs.npz}", "{people.npz}"),
    "files": ("{pairs.npz}", "{clip.bvh}", "{points.c3d}", "{arm.amc}", "{arm.asf}"),
    "model": ("{model.npz}",),
    "person": ("s1", "nobody"),
    "database": ("{database.npz}",),
    "contacts": ("{contacts.csv}", "{clip.npz}"),
    "scene": _SCENES,
    "config_file": ("{options.toml}",),
    "thresholds": ("{limits.toml}",),
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
    "methods": (*METHODS, "none,default", "kalman,butterworth", "nothing"),
    "set": ("neighbors=7", "steps=2", "style=0", "neighbors=0", "=", "rate_frames=x"),
    "presets": ("shum-2012", "wang-low-rank,shum-2012", "wang-low-rank:growth=2", "x"),
    "hide": ("left-arm", "arms", "shins", "left-hand", "tail"),
    "gap": ("55%", "0.2", "5%", "200%", "x"),
    "count": ("20", "2", "1", "10000000"),
    "speed": ("1000", "1e9", "50", "0", "nan", "inf"),
    "source": ("-", "-", "-", "udp://127.0.0.1:99999", "x"),
    "bodies": ("1", "6", "0", "99"),
    "start": ("0", "0.1", "0.3", "99"),
    "to": ("0.2", "0.4", "0", "99"),
    "jobs": ("1", "1", "2", "0"),
}
_WRITTEN = {
    "clean": [
        f"o.{suffix}"
        for suffix in ("usda", "usdc", "usd", "usdz", "bvh", "csv", "npz", "npz", "txt")
    ],
    "batch": ["clips"],
    "render": ["o.mp4", "o.gif", "o%05d.png", "{clip}.mp4", "o.png"],
    "report": ["o.html"],
    "character": ["o.xml"],
    "simulate": ["o.csv"],
    "live": ["-"],
    "replay": ["udp://127.0.0.1:9", "-", "ws://127.0.0.1:1", "vmc://127.0.0.1:1"],
}
_ALSO_WRITTEN = {
    "json": "{out}/o.json",
    "report": "{out}/o.html",
    "save_contacts": "{out}/contacts.csv",
    "record": "{out}/o.csv",
    "truth": "{out}/truth.csv",
}
# Without end, or for minutes, or on machines that are not there.
_LEFT_OUT = {
    *("loop", "simulated", "furnished", "scripted", "scheduler", "given", "views"),
    *("sync", "bind", "origin", "ablation", "shadows"),
}
_SLOW = {"learned", "full-gp", "local-gp", "clustered-gp"}  # to learn


def abuse_options(attempt: Attempt) -> None:
    """Run a command with random options.

    Raises InputError where it is refused, and LostError or whatever went wrong.
    """
    rng = attempt.rng
    (name,) = rng.choices(list(_WEIGHTS), list(_WEIGHTS.values()))
    attempt.what = name
    here = attempt.folder / "in"
    here.mkdir()
    if name == "batch":
        for take in rng.sample(_TAKES[:9], 3):
            shutil.copy(attempt.files[take[1:-1]], here)
    words = [*name.split(), *_words(name, rng)]
    words = ["".join(attempt.command(word, valid=here)) for word in words]
    before = os.dup(0)
    with attempt.files["frames.jsonl"].open("rb") as frames:  # for live
        os.dup2(frames.fileno(), 0)
    try:
        with mock.patch("kinefilter.pipeline.batch.run.open_crew", Here):
            attempt.run(words)
    finally:
        os.dup2(before, 0)
        os.close(before)


def _words(name: str, rng: random.Random) -> Iterator[str]:
    """Yield positional arguments and options of a command."""
    kinds = {"database build": DatabaseBuild, "database info": DatabaseInfo}
    placed: list[str] = []
    for field, hint, needed in _options(kinds.get(name) or _command(name)):
        needed |= (name, field) == ("train", "method")  # its default takes minutes
        positional = _POSITIONAL in getattr(hint, "__metadata__", ())
        if (
            field.startswith("_")
            or field in _LEFT_OUT
            or not (needed or rng.random() < (0.95 if positional else _OFTEN))
        ):
            continue
        values = _values(name, field, hint, rng)
        if positional:
            placed += values
        elif values:
            flag = {"start": "from", "config_file": "config", "source": "in"}
            yield f"--{flag.get(field, field).replace('_', '-')}"
            yield from values
        else:
            on = field in ("physics", "reconstruct")
            yield f"--{'no-' if on else ''}{field.replace('_', '-')}"
    yield from placed


def _options(kind: Any) -> Iterator[tuple[str, Any, bool]]:
    """Yield name, type and whether it is needed, for all options of a command."""
    hints = get_type_hints(kind, include_extras=True)
    for field in fields(kind):
        hint = hints[field.name]
        inner = get_args(hint)[0] if get_origin(hint) is Annotated else hint
        if is_dataclass(inner):
            yield from _options(inner)
        else:
            bare = field.default is MISSING and field.default_factory is MISSING
            yield field.name, hint, bare


def _values(name: str, field: str, hint: Any, rng: random.Random) -> list[str]:
    """Return the words after an option, none for a switch."""
    if field == "out":
        written = _WRITTEN.get(name, ["o.npz"])
        word = rng.choice(written)
        return [word if name in ("live", "replay") else f"{{out}}/{word}"]
    if field in _ALSO_WRITTEN and not (name == "info" and field == "json"):
        return [_ALSO_WRITTEN[field]]
    if name == "simulate" and field == "pairs":
        return ["{out}/pairs.npz"]
    kinds = [hint]
    while get_origin(kinds[0]) in (Annotated, Union, UnionType):
        first = get_args(kinds[0])
        kinds = [*(first[:1] if get_origin(kinds[0]) is Annotated else first)]
        kinds = [kind for kind in kinds if kind is not type(None)]
    kind = rng.choice(kinds)
    count = rng.choice((1, 1, 2)) if get_origin(kind) is tuple else 1
    if field in ("out", "fail_on", "same_person"):
        count = 1
    return [word for _ in range(count) for word in _value(name, field, kind, rng)]


def _value(name: str, field: str, kind: Any, rng: random.Random) -> list[str]:
    if field == "skeleton" and name == "live":
        return ["kinect_v1"]
    if get_origin(kind) is Literal:
        known = [
            word for word in get_args(kind) if name != "train" or word not in _SLOW
        ]
        return [rng.choice(known)]
    if kind is bool:
        return []
    if field in _USED and rng.random() < 0.95:
        return [rng.choice(_USED[field])]
    if kind is int:
        return [rng.choice(_COUNTS)]
    return [rng.choice(_NUMBERS if kind is float else _WRONG)]
