"""People of a live session in one scene: they come, go, push and hold things."""

from __future__ import annotations

import asyncio
import gc
import json
from pathlib import Path
from typing import Any
from unittest.mock import Mock
from weakref import ref

import numpy as np
import pytest
from live_session import SAMPLE, Sender, config, do, reading, running, sample_frame
from numpy.typing import NDArray
from test_holding import BODY, PARCEL, reaching
from websockets.asyncio.client import ClientConnection

from kinefilter import Avatar, SharedScene
from kinefilter.characters import KINECT_V1, TRACKINGS, InputError, standard_body
from kinefilter.pipeline.live import crowd
from kinefilter.pipeline.live.crowd import Person
from kinefilter.pipeline.live.live_session import Session
from kinefilter.pipeline.live.messages import Frame, Reason, SeenBody, format_frame
from kinefilter.pipeline.live.tally import Event
from kinefilter.pipeline.physics import playable, scene_props

Array = NDArray[np.float64]
TALL = standard_body(KINECT_V1, height=1.8)
CHEST = KINECT_V1.joints[KINECT_V1.girdle]


def test_nobody_notices_who_comes_and_goes_out_of_reach() -> None:
    scene = SharedScene("box", TRACKINGS["game"])
    one, other = Avatar(TALL, scene), Avatar(BODY, scene)
    alone = Avatar(TALL, "box", tracking="game")
    for row in range(60):
        seen, state = SAMPLE.positions[row], SAMPLE.state[row]
        time = row / 30.0
        one.step(seen, time, state)
        if 20 <= row < 40:
            other.step(seen + np.array([1.5, 0.0, 0.0]), time, state)
        if row == 40:
            other.leave()
        scene.advance()
        assert len(scene.people) == 1 + (20 <= row < 40)
        wanted = alone.step(seen, time, state)
        np.testing.assert_allclose(one.pose.positions, wanted.positions, atol=1e-6)
        force = one.pose.external_force - wanted.external_force
        assert abs(force) < 1e-3 or row < 2
    with pytest.raises(InputError, match="in the scene"):
        other.push(CHEST, [0.0, 0.0, 1.0], 0.1)


def test_what_is_held_and_who_fell_stay_so_when_somebody_comes(tmp_path: Path) -> None:
    path = tmp_path / "parcel.xml"
    path.write_text(PARCEL)
    touch = 0.1 + BODY.radii[KINECT_V1.index("HandLeft")]
    time = np.arange(150) / 30.0
    apart = np.interp(time, [0.0, 1.0], [0.25, touch])
    positions, _ = reaching(apart, np.interp(time, [1.5, 3.0], [1.0, 1.35]))
    scene = SharedScene(path, TRACKINGS["game"])
    holder, fallen, late = (Avatar(BODY, scene, name=name) for name in "abc")
    heights = []
    for k, seconds in enumerate(time.tolist()):
        holder.step(positions[k], seconds)
        fallen.step(BODY.rest_positions + np.array([2.0, 0.0, 0.0]), seconds)
        if k == 60:
            fallen.push(CHEST, [2500.0, 0.0, 0.0], 0.3)
        if k >= 100:
            late.step(BODY.rest_positions - np.array([2.0, 0.0, 0.0]), seconds)
        scene.advance()
        if k in (99, 101):
            assert fallen.physics.compliance is not None
            assert not fallen.physics.compliance.follows
            assert (holder.holds, fallen.holds) == ("parcel", None)
        heights.append(
            next(p for p in scene.props if p.name == "parcel").positions[0, 1]
        )
    assert min(heights[98:]) > 1.2


def test_what_a_scene_is_told_wrongly_is_refused() -> None:
    with pytest.raises(InputError, match="tracking"):
        SharedScene("box", "hard")  # type: ignore[arg-type]
    scene, ahead, nan = SharedScene("box", "game"), [0.0, 0.0, 1.0], [np.nan, 0, 0]
    for early in (
        lambda: scene.throw(ahead, ahead),
        lambda: scene.hit_by(ahead, ahead),
        lambda: scene.props,
        lambda: scene.shove(0, ahead),
    ):
        with pytest.raises(InputError, match="in the scene"):
            early()
    Avatar(BODY, scene).step(BODY.rest_positions, 0.0)
    for wrong, words in (
        (lambda: scene.throw(nan, ahead), "place of a throw"),
        (lambda: scene.throw(ahead, [1.0, 0.0]), r"expected \(3,\)"),
        (lambda: scene.hit_by(ahead, [0.0, 0.0, 0.0]), "ray is zero"),
        (lambda: scene.shove(0, [0.0, 0.0, 0.0]), "shove is zero"),
        (lambda: scene.shove(0, ahead, 1), "no character 1"),
        (lambda: scene.shove(99, ahead), "joint 99"),
        (lambda: scene.place("box", nan, [1, 0, 0, 0]), "position of a prop"),
        (lambda: scene.place("box", ahead, [1, 0, 0]), r"expected \(4,\)"),
        (lambda: scene.place("box", ahead, [0, 0, 0, 0]), "rotation of a prop"),
    ):
        with pytest.raises(InputError, match=words):
            wrong()
    assert scene.place("box", ahead, [1, 0, 0, 0])
    scene.throw(ahead, ahead)


@pytest.mark.parametrize(
    ("place", "low", "high"),
    [
        ([1.5, -5.0, 1.5], 0.14, 0.21),  # in the floor
        ([0.0, 1.0, 0.05], 1.8, 2.1),  # in the person
        ([-0.95, 0.42, 0.5], 0.55, 0.65),  # in the top of the table
        ([0.0, 2.5, 0.0], 2.48, 2.5),  # in the air
    ],
)
def test_a_prop_put_into_something_is_put_above_it_and_not_flung_out(
    place: list[float], low: float, high: float
) -> None:
    scene = SharedScene("box", "game")
    person, heights = Avatar(BODY, scene), []
    for row in range(30):
        person.step(BODY.rest_positions, row / 30.0)
        if row == 5:
            assert scene.place("box", place, [1, 0, 0, 0])
        scene.advance()
        box = next(p for p in scene.props if p.name == "box")
        heights.append(box.positions[0, 1])
    assert low < heights[5] < high
    assert max(heights[5:]) <= heights[5] + 0.02


def test_a_prop_without_room_above_stays_where_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = SharedScene("box", "game")
    Avatar(BODY, scene).step(BODY.rest_positions, 0.0)
    scene.advance()
    before = scene.world.data.qpos.copy()
    monkeypatch.setattr(scene_props, "_RAISES", 3)
    assert not scene.place("box", [0.0, 1.0, 0.05], [1, 0, 0, 0])
    np.testing.assert_array_equal(scene.world.data.qpos, before)


def test_a_push_goes_on_when_somebody_else_leaves() -> None:
    def moved(*, company: bool) -> Array:
        scene = SharedScene("basic", TRACKINGS["game"])
        first, pushed = Avatar(BODY, scene), Avatar(BODY, scene)
        chests = []
        for row in range(60):
            if company and row < 35:
                first.step(BODY.rest_positions - np.array([3.0, 0.0, 0.0]), row / 30.0)
            if row == 35:
                first.leave()
            pushed.step(BODY.rest_positions, row / 30.0)
            if row == 30:
                pushed.push(CHEST, [0.0, 0.0, 250.0], 0.5)
            scene.advance()
            chests.append(pushed.pose.positions[KINECT_V1.girdle])
        return np.array(chests) - chests[29]

    alone, beside = moved(company=False), moved(company=True)
    assert np.abs(alone).max() > 0.05
    np.testing.assert_allclose(beside, alone, atol=1e-3)


def test_worlds_that_people_left_are_freed_without_garbage_collection() -> None:
    scene, old = SharedScene("box", TRACKINGS["game"]), []
    stays, goes = Avatar(BODY, scene), Avatar(BODY, scene)
    gc.collect()
    gc.disable()
    try:
        for row in range(4):
            stays.step(BODY.rest_positions, row / 30.0)
            if row == 2:
                goes.leave()
            elif row < 2:
                goes.step(BODY.rest_positions - np.array([3.0, 0, 0]), row / 30.0)
            scene.advance()
            old.append(ref(scene.world))
        alive = {id(world()) for world in old if world() is not None}
    finally:
        gc.enable()
    assert old[0]() is not scene.world
    assert alive == {id(scene.world)}


def test_two_people_in_one_place_push_each_other_apart() -> None:
    scene = SharedScene("basic", TRACKINGS["game"])
    people = [Avatar(BODY, scene, name=name) for name in ("anna", "ben")]
    met = set()
    for row in range(60):
        beside = max(0.2, 1.0 - row / 30.0)
        for k, person in enumerate(people):
            place = np.array([k * beside, 0.0, 2.0])
            person.step(BODY.rest_positions + place, row / 30.0)
        scene.advance()
        met |= {contact.other for contact in people[0].contacts}
    assert met == {"floor", "ben"}
    hips = [person.pose.positions[KINECT_V1.root] for person in people]
    assert np.linalg.norm(hips[0] - hips[1]) > 0.25


async def _line(stream: ClientConnection, kind: str) -> dict[str, Any]:
    """Return the next line of a kind."""
    while kind not in (line := json.loads(await stream.recv())):
        pass
    return dict(line)


def _two(row: int) -> Frame:
    """Return a frame of the sample's performer and of somebody 1.5 m beside them."""
    (seen,) = sample_frame(row).bodies
    other = SeenBody("2", seen.positions + np.array([1.5, 0.0, 0.0]), seen.state)
    return Frame(row / 30.0, (seen, other))


def test_readers_get_props_and_contacts_and_send_pushes_and_things() -> None:
    async def session() -> None:
        async with running(config(scene="box", tracking="game")) as (
            run,
            (source, out),
        ):
            sender, row = Sender(source), 0
            async with reading(out) as stream:

                async def poses(count: int) -> list[dict[str, Any]]:
                    nonlocal row
                    found = []
                    for _ in range(count):
                        sender.send(_two(row))
                        row += 1
                        found.append([await _line(stream, "positions") for _ in "12"])
                    return found[-1]

                await poses(1)
                async with reading(out) as late:
                    described = await _line(late, "scene")
                box = next(p for p in described["props"] if p["name"] == "box")
                assert box["shapes"][0]["kind"] == "box"
                one, other = await poses(15)
                assert (one["body"], other["body"]) == ("1", "2")
                apart = np.subtract(other["root"], one["root"])
                assert abs(np.linalg.norm(apart) - 1.5) < 0.02
                assert {c["with"] for c in one["contacts"]} == {"floor"}
                weight = sum(c["force"] for c in one["contacts"])
                assert 0.5 < weight / (TALL.mass * 9.81) < 1.5

                push = {
                    "body": "2",
                    "joint": CHEST,
                    "force": [0, 0, -400],
                    "seconds": 0.3,
                }
                await stream.send(json.dumps({"push": push}))
                place = {"prop": "box", "position": [2, 1, 2], "rotation": [1, 0, 0, 0]}
                await stream.send(json.dumps({"place": place}))
                while run.tally.events[Event.OBEYED] < 2:
                    await asyncio.sleep(0)
                before = other["positions"][KINECT_V1.girdle]
                sender.send(_two(row))
                row += 1
                moved = await _line(stream, "props")
                assert (
                    np.abs(np.subtract(moved["props"]["box"][:3], [2, 1, 2])).max()
                    < 0.1
                )
                _, other = await poses(9)
                assert other["positions"][KINECT_V1.girdle][2] < before[2] - 0.03

                for command in (
                    {"push": {**push, "body": "3"}},
                    {"push": {**push, "joint": "Tail"}},
                    {"place": {**place, "prop": "table"}},
                ):
                    await stream.send(json.dumps(command))
                await stream.send(json.dumps({"time": 0, "bodies": []}))
                while run.tally.malformed.total() < 4:
                    await asyncio.sleep(0)
                assert run.tally.malformed == {Reason.UNKNOWN: 3, Reason.COMMAND: 1}
                (note,) = run.tally.notes[Reason.UNKNOWN]  # the first one's
                assert note == f"a push names '3', '{push['joint']}'"
                ball = {"position": [0, 1, 2], "velocity": [0, 0, -10]}
                sender.send(json.dumps({"throw": ball}).encode())
                await poses(10)
                hit = await _line(stream, "props")
                assert any(name.startswith("thrown") for name in hit["props"])

    do(session())


def test_the_scene_is_described_again_when_somebody_leaves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def session() -> None:
        async with running(config(scene="box")) as (_, (source, out)):
            sender = Sender(source)
            async with reading(out) as stream:
                sender.send(_two(0))
                await _line(stream, "scene")
                monkeypatch.setattr(crowd, "_GONE", 0.0)
                assert await _line(stream, "gone") == {"body": "1", "gone": True}
                assert (await _line(stream, "scene"))["props"]

    do(session())


def test_without_a_scene_people_are_alone_and_can_be_pushed() -> None:
    async def session() -> None:
        async with running(config(tracking="game")) as (run, (source, out)):
            sender = Sender(source)
            async with reading(out) as stream:
                sender.send(_two(0))
                one = await _line(stream, "positions")
                assert "contacts" not in one
                push = {"body": "1", "joint": CHEST, "force": [0, 0, 9], "seconds": 1}
                sender.send(json.dumps({"push": push}).encode())
                throw = {"position": [0, 1, 2], "velocity": [0, 0, -10]}
                sender.send(json.dumps({"throw": throw}).encode())
                while not run.tally.malformed.total():
                    await asyncio.sleep(0)
                assert run.tally.events[Event.OBEYED] == 1
                assert run.tally.malformed == {Reason.UNKNOWN: 1}
                assert "need --scene" in run.tally.notes[Reason.UNKNOWN][0]

    do(session())


def test_a_push_before_a_person_is_in_the_scene_is_ignored() -> None:
    session = Session(config(source="-", scene="box"))
    session.receive(format_frame(sample_frame(0)))
    turn = session.crowd.next()
    assert turn is not None
    turn[0].person = Person(session._config, session.scene, "1")  # has a body, no frame
    push = {"body": "1", "joint": CHEST, "force": [0, 0, 9], "seconds": 1}
    session.command(json.dumps({"push": push}))
    assert session.tally.malformed == {Reason.UNKNOWN: 1}


def test_who_cannot_be_in_the_scene_leaves_the_others_as_they_were(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = SharedScene("basic", TRACKINGS["faithful"])
    one, other = Avatar(BODY, scene), Avatar(TALL, scene)
    one.step(BODY.rest_positions, 0.0)
    scene.advance()
    there = TALL.rest_positions + np.array([1.5, 0.0, 0.0])
    with monkeypatch.context() as patched:
        patched.setattr(playable, "World", Mock(side_effect=ValueError("no room")))
        with pytest.raises(ValueError, match="no room"):
            other.step(there, 0.0)
    for row in range(1, 10):
        one.step(BODY.rest_positions, row / 30.0)
        scene.advance()
    assert one.pose.positions[KINECT_V1.root, 1] > 0.9
    other.step(there, 1.0)
    assert len(scene.people) == len(scene.characters) == 2
