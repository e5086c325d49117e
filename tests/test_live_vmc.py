"""Poses by VMC, as a real OSC server receives them: checked bone by bone."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from conftest import MakeClip
from live_session import (
    PATIENCE,
    WS,
    Sender,
    config,
    do,
    pose,
    reading,
    running,
    sample_frame,
)
from numpy.typing import NDArray
from pythonosc.dispatcher import Dispatcher
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_server import AsyncIOOSCUDPServer
from scipy.spatial.transform import Rotation

from kinefilter import Avatar, Pose
from kinefilter.characters import KINECT_V1, standard_body
from kinefilter.pipeline.live.osc import LARGEST_BUNDLE
from kinefilter.pipeline.live.vmc import VmcFigure
from kinefilter.retarget.retargeting import turned
from kinefilter.retarget.rig_map import load_rig_map
from kinefilter.retarget.target_rig import built_rig

Array = NDArray[np.float64]

BODY = standard_body(KINECT_V1, height=1.8)
RIG = built_rig(load_rig_map("vrm"), BODY)
REST = RIG.rest
UNITY = [name[0].upper() + name[1:] for name in REST.names]
MIRROR = np.array([-1.0, 1.0, 1.0])

LIMBS = {  # bone and the joint of ours at its end, after the joint where it begins
    "LowerArm": ("Shoulder", "Elbow"),
    "Hand": ("Elbow", "Wrist"),
    "LowerLeg": ("Hip", "Knee"),
    "Foot": ("Knee", "Ankle"),
}
PARENTS = {"LowerArm": "UpperArm", "Hand": "LowerArm"}
PARENTS |= {"LowerLeg": "UpperLeg", "Foot": "LowerLeg"}


@dataclass
class Received:
    """What an engine got of one pose."""

    time: float = -1.0
    root: tuple[float, ...] = ()
    bones: dict[str, tuple[float, ...]] = field(default_factory=dict)


class Engine:
    """Gathers poses of the messages that come."""

    def __init__(self) -> None:
        self.poses: list[Received] = []
        self.absent = 0
        self.came = asyncio.Event()
        self.dispatcher = Dispatcher()
        self.dispatcher.map("/VMC/Ext/OK", self._ok)
        self.dispatcher.map("/VMC/Ext/T", self._time)
        self.dispatcher.map("/VMC/Ext/Root/Pos", self._root)
        self.dispatcher.map("/VMC/Ext/Bone/Pos", self._bone)

    def _ok(self, _: str, loaded: int) -> None:
        if loaded:
            self.poses.append(Received())
        else:
            self.absent += 1
        self.came.set()

    def _time(self, _: str, seconds: float) -> None:
        self.poses[-1].time = seconds

    def _root(self, _: str, name: str, *place: float) -> None:
        assert name == "root"
        self.poses[-1].root = place

    def _bone(self, _: str, name: str, *place: float) -> None:
        assert name not in self.poses[-1].bones
        self.poses[-1].bones[name] = place
        self.came.set()

    async def whole(self, count: int) -> None:
        """Wait until some poses are here with all their bones."""
        async with asyncio.timeout(PATIENCE):
            while sum(len(p.bones) == len(UNITY) for p in self.poses) < count:
                self.came.clear()
                await self.came.wait()


@asynccontextmanager
async def listening(port: int = 0) -> AsyncIterator[tuple[Engine, int]]:
    """Run a python-osc server; yields what it gathers, and its port."""
    engine, loop = Engine(), asyncio.get_running_loop()
    server: Any = AsyncIOOSCUDPServer(("127.0.0.1", port), engine.dispatcher, loop)  # type: ignore[arg-type]
    transport, _ = await server.create_serve_endpoint()
    try:
        yield engine, int(transport.get_extra_info("sockname")[1])
    finally:
        transport.close()


def world(received: Received) -> tuple[Array, Rotation]:
    """Return where a VRM of the rest pose's bones is then, in our axes, (N, 3).

    In Unity's axes as an engine does it, from local rotations alone; of positions only
    that of the hips is used.
    """
    assert set(received.bones) == set(UNITY)
    assert received.root == (0, 0, 0, 0, 0, 0, 1)
    turns: list[Rotation] = []
    places = np.zeros((len(UNITY), 3))
    for n, (name, parent) in enumerate(zip(UNITY, REST.parents, strict=True)):
        local = Rotation.from_quat(received.bones[name][3:])
        if parent < 0:
            turns.append(local)
            places[n] = received.bones[name][:3]
            continue
        bone = (REST.positions[n] - REST.positions[parent]) * MIRROR
        turns.append(turns[parent] * local)
        places[n] = places[parent] + turns[parent].apply(bone)
    return places * MIRROR, Rotation.concatenate(turns)


async def received_and_sent(rows: range) -> tuple[Engine, list[dict[str, Any]]]:
    async with listening() as (engine, port):
        what = config(f"vmc://127.0.0.1:{port}", WS)
        async with running(what) as (_, places), reading(places[2]) as stream:
            sender, poses = Sender(places[0]), []
            for row in rows:
                sender.send(sample_frame(row))
                poses.append(await pose(stream))
            await engine.whole(len(rows))
    return engine, poses


@pytest.fixture(scope="module")
def stream() -> tuple[Engine, list[dict[str, Any]]]:
    """Return what a server received of half the sample take, and its poses."""
    return asyncio.run(received_and_sent(range(150)))


def test_every_bone_of_every_pose_is_received(
    stream: tuple[Engine, list[dict[str, Any]]],
) -> None:
    engine, poses = stream
    assert len(engine.poses) == len(poses) == 150
    for got, sent in zip(engine.poses, poses, strict=True):
        assert got.time == pytest.approx(sent["time"] - poses[0]["time"], abs=1e-5)


def test_limbs_of_a_vrm_turned_so_are_where_the_poses_are_within_a_millimeter(
    stream: tuple[Engine, list[dict[str, Any]]],
) -> None:
    """Bone by bone: each spans what our segment spans, as limbs are as long."""
    worst = dict.fromkeys(LIMBS, 0.0)
    for got, sent in zip(*_both(stream), strict=True):
        places, _ = world(got)
        ours = np.array(sent["positions"])
        for bone, (start, end) in LIMBS.items():
            for side in ("Left", "Right"):
                theirs = _at(places, side + bone) - _at(places, side + PARENTS[bone])
                wanted = _joint(ours, end + side) - _joint(ours, start + side)
                worst[bone] = max(worst[bone], np.linalg.norm(theirs - wanted))
    assert max(worst.values()) < 1e-3, worst


def test_hips_chest_head_and_feet_turn_and_stand_as_ours(
    stream: tuple[Engine, list[dict[str, Any]]],
) -> None:
    index = KINECT_V1.index
    segments = {"Hips": index("HipCenter"), "Head": index("Head")}
    segments |= {"LeftFoot": index("FootLeft"), "RightToes": index("FootRight")}
    for got, sent in zip(*_both(stream), strict=True):
        places, turns = world(got)
        for name, joint in segments.items():
            w, x, y, z = sent["rotations"][joint]
            wanted = Rotation.from_quat([x, -y, -z, w])
            away = (turns[UNITY.index(name)] * wanted.inv()).magnitude()
            if "Foot" in name or "Toes" in name:
                # The VRM's feet point straight ahead at rest, ours a little aside.
                assert away < np.radians(12.0)
            else:
                assert away < 1e-3
        thighs = [_at(places, f"{side}UpperLeg") for side in ("Left", "Right")]
        ours = [
            _joint(np.array(sent["positions"]), f"Hip{s}") for s in ("Left", "Right")
        ]
        middle = np.mean(thighs, axis=0) - np.mean(ours, axis=0)
        np.testing.assert_allclose(middle[[0, 2]], 0.0, atol=1e-4)
        toes = min(_at(places, f"{side}Toes")[1] for side in ("Left", "Right"))
        sole = BODY.radii[index("FootLeft")]
        assert -0.03 < toes - sole < 0.04


def test_every_bone_turns_as_retargeting_turns_it(make_clip: MakeClip) -> None:
    clip = make_clip(20, KINECT_V1, seed=4, body=BODY, wild=True)
    wanted, figure = turned(clip, RIG), VmcFigure(BODY)
    for k in range(len(clip)):
        pose = Pose(
            clip.positions[k], clip.rotations[k], clip.contacts[k, :2], 0.0, False
        )
        received = Received(root=(0, 0, 0, 0, 0, 0, 1))
        for name, (place, turn) in figure.bones(pose).items():
            received.bones[name] = (*place, *np.roll(turn, -1))
        _, turns = world(received)
        for n, bone in enumerate(UNITY):
            w, x, y, z = wanted[n][k]
            away = turns[n].inv() * Rotation.from_quat([x, -y, -z, w])
            assert away.magnitude() < 1e-6, bone


def test_a_left_arm_raised_is_unitys_left_arm_raised() -> None:
    raised = BODY.rest_positions.copy()
    for joint, length in (("Elbow", 0.3), ("Wrist", 0.55), ("Hand", 0.65)):
        shoulder = raised[KINECT_V1.index("ShoulderLeft")]
        raised[KINECT_V1.index(f"{joint}Left")] = shoulder + np.array(
            [0.0, length, 0.0]
        )
    figure, avatar = VmcFigure(BODY), Avatar(BODY, floor=0.0)
    for k in range(10):
        there = figure.bones(avatar.step(raised, k / 30.0))
    received = Received(root=(0, 0, 0, 0, 0, 0, 1))
    for name, (place, turn) in there.items():
        received.bones[name] = (*place, *np.roll(turn, -1))
    places = world(received)[0] * MIRROR  # Unity's: x to the right, facing +z
    left, right, head = (_at(places, n) for n in ("LeftHand", "RightHand", "Head"))
    assert left[0] < -0.1
    assert right[0] > 0.5
    assert left[1] > head[1] > right[1]
    assert _at(places, "LeftToes")[2] > _at(places, "LeftFoot")[2]


def test_bundles_fit_into_a_packet_and_read_back() -> None:
    figure, avatar = VmcFigure(BODY), Avatar(BODY, floor=0.0)
    bundles = figure.bundles(avatar.step(BODY.rest_positions, 0.0), 0.0)
    assert all(len(bundle) <= LARGEST_BUNDLE for bundle in bundles)
    assert sum(OscBundle(bundle).num_contents for bundle in bundles) == 3 + len(UNITY)


@asynccontextmanager
async def listening_side_by_side() -> AsyncIterator[tuple[Engine, Engine, int]]:
    """Run two servers at a port and the next; yields both and the first port."""
    async with AsyncExitStack() as stack:
        while True:
            first, port = await stack.enter_async_context(listening())
            try:
                second, _ = await stack.enter_async_context(listening(port + 1))
            except OSError:
                continue
            yield first, second, port
            return


def test_the_second_person_goes_to_the_next_port_and_who_leaves_is_told() -> None:
    async def session() -> None:
        async with (
            listening_side_by_side() as (first, second, port),
            running(config(f"vmc://127.0.0.1:{port}")) as (run, places),
        ):
            Sender(places[0]).send(sample_frame(0, "a", "b"))
            await asyncio.gather(first.whole(1), second.whole(1))
            for presence in run.crowd._here.values():
                presence.last_seen -= 10.0
            for engine in (first, second):
                while not engine.absent:
                    engine.came.clear()
                    await engine.came.wait()

    do(session())


def test_an_engine_that_comes_back_goes_on() -> None:
    async def session() -> None:
        async with listening() as (engine, port):
            pass
        what = config(f"vmc://127.0.0.1:{port}", WS)
        async with running(what) as (_, places), reading(places[2]) as stream:
            sender = Sender(places[0])
            for row in range(5):  # into the void
                sender.send(sample_frame(row))
                await pose(stream)
            async with listening(port) as (engine, _):
                for row in range(5, 8):
                    sender.send(sample_frame(row))
                    await pose(stream)
                await engine.whole(3)
            assert engine.poses[-1].time == pytest.approx(7 / 30.0, abs=1e-5)

    do(session())


def _both(
    stream: tuple[Engine, list[dict[str, Any]]],
) -> tuple[list[Received], list[dict[str, Any]]]:
    return stream[0].poses, stream[1]


def _at(places: Array, bone: str) -> Array:
    return np.asarray(places[UNITY.index(bone)])


def _joint(positions: Array, name: str) -> Array:
    return np.asarray(positions[KINECT_V1.index(name)])
