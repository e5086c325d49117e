"""Messages that no sensor sends: noise, cut, huge, deep, misnamed, not numbers."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from kinefilter.characters import KINECT_V1, standard_body

_BODY = standard_body(KINECT_V1)

Rng = np.random.Generator


def good(time: float = 0.0) -> dict[str, Any]:
    """Return a frame of somebody who stands, as data."""
    places = (_BODY.rest_positions + np.array([0.0, 0.0, 2.0])).tolist()
    joints = {
        name: [*place, 2] for name, place in zip(KINECT_V1.joints, places, strict=True)
    }
    return {"time": time, "bodies": [{"id": "1", "joints": joints}]}


def _noise(rng: Rng) -> bytes:
    return rng.bytes(int(rng.integers(1, 2000)))


def _cut(rng: Rng) -> bytes:
    text = json.dumps(good()).encode()
    return text[: int(rng.integers(1, len(text) - 1))]


def _huge(rng: Rng) -> bytes:
    number = str(rng.choice(["1e999", "-1e308", "9" * 5000, "1e5"]))
    return _with_number(number)


def _no_number(rng: Rng) -> bytes:
    return _with_number(str(rng.choice(["NaN", "Infinity", "-Infinity"])))


def _with_number(number: str) -> bytes:
    frame = good()
    frame["bodies"][0]["joints"]["Head"][1] = "@"
    return json.dumps(frame).replace('"@"', number).encode()


def _deep(rng: Rng) -> bytes:
    depth = int(rng.integers(2000, 10_000))
    opening = str(rng.choice(["[", '{"time":']))
    return (opening * depth).encode()[: 2**15]


def _too_long(rng: Rng) -> bytes:
    frame = good()
    frame["bodies"][0]["id"] = "x" * int(rng.integers(2**15, 60_000))
    return json.dumps(frame).encode()


def _edited(rng: Rng) -> bytes:
    frame = good()
    body = frame["bodies"][0]
    edits: list[Callable[[], Any]] = [
        lambda: body["joints"].update(Tail=[0, 0, 1]),
        lambda: body["joints"].update(Head=[0, 1]),
        lambda: body["joints"].update(Head=[True, 1, 2]),
        lambda: body["joints"].update(Head="__import__('os')"),
        lambda: body["joints"].update(Head=[0.1, 0.2, 0.3, 7]),
        lambda: body.update(joints=[[0, 0, 1]] * 3),
        lambda: body.update(joints=None),
        lambda: body.update(id={"$ref": "/etc/passwd"}),
        lambda: body.update(id="\n" * 5),
        lambda: body.update(id=-1),
        lambda: body.update(path="../../take.csv"),
        lambda: frame.update(time="now"),
        lambda: frame.update(time=None),
        lambda: frame.update(time=1e300),
        lambda: frame.pop("time"),
        lambda: frame.update(bodies={}),
        lambda: frame.update(bodies=[body] * 2),
        lambda: frame.update(bodies=[{**body, "id": n} for n in range(33)]),
        lambda: frame.update(extra=1),
    ]
    edits[int(rng.integers(len(edits)))]()
    return json.dumps(frame).encode()


def _command(rng: Rng) -> bytes:
    here, still = [0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    push = {"body": "1", "joint": "Head", "force": here, "seconds": 0.1}
    place = {"prop": "box", "position": here, "rotation": still}
    commands: list[Any] = [
        {"push": here},
        {"push": {**push, "force": 300.0}},
        {"push": {**push, "force": [1e9, 0.0, 0.0]}},
        {"push": {**push, "seconds": "long"}},
        {"push": {**push, "seconds": -1.0}},
        {"push": {**push, "joint": None}},
        {"push": push, "throw": {}},
        {"throw": {"position": here}},
        {"throw": {"position": here, "velocity": [0.0, 0.0, "1e999"]}},
        {"place": {**place, "prop": ["box"]}},
        {"place": {**place, "rotation": here}},
        {"place": {**place, "path": "../box.xml"}},
    ]
    return json.dumps(commands[int(rng.integers(len(commands)))]).encode()


_KINDS = (
    *(_noise, _cut, _huge, _no_number, _deep, _too_long, _edited, _edited, _command),
)


def hostile_messages(count: int, *, seed: int) -> Iterator[bytes]:
    """Yield messages, neither commands nor frames of Kinect v1, all under 64 KB."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        yield _KINDS[k % len(_KINDS)](rng)
