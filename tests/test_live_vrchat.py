"""VRChat's trackers through a real socket, read by python-osc as VRChat has them."""

from __future__ import annotations

import asyncio
from typing import Any

import numpy as np
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
from pythonosc.dispatcher import Dispatcher
from pythonosc.osc_server import AsyncIOOSCUDPServer
from scipy.spatial.transform import Rotation

from kinefilter.characters import KINECT_V1

_MIRROR = np.diag([-1.0, 1.0, 1.0])
# Joint of each tracker, and the joint at the end of the segment that turns it.
_TRACKERS = {
    "1": ("HipCenter", "HipCenter"),
    "2": ("ShoulderCenter", "ShoulderCenter"),
    "3": ("AnkleLeft", "FootLeft"),
    "4": ("AnkleRight", "FootRight"),
    "5": ("KneeLeft", "KneeLeft"),
    "6": ("KneeRight", "KneeRight"),
    "7": ("ElbowLeft", "ElbowLeft"),
    "8": ("ElbowRight", "ElbowRight"),
    "head": ("Head", "Head"),
}


def _unity(x: float, y: float, z: float) -> Any:
    """Return the matrix of Unity's Euler angles [degrees]: z first, then x, then y."""
    (a, b, c), (d, e, f) = np.cos(np.radians([x, y, z])), np.sin(np.radians([x, y, z]))
    about_x = np.array([[1, 0, 0], [0, a, -d], [0, d, a]])
    about_y = np.array([[b, 0, e], [0, 1, 0], [-e, 0, b]])
    about_z = np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]])
    return about_y @ about_x @ about_z


def test_every_tracker_is_where_its_joint_is_and_turns_as_its_segment() -> None:
    async def session() -> None:
        got, came, dispatcher = dict[str, Any](), asyncio.Event(), Dispatcher()

        def note(address: str, *values: float) -> None:
            got[address] = values
            came.set()

        dispatcher.map("/tracking/*", note)
        loop = asyncio.get_running_loop()
        server: Any = AsyncIOOSCUDPServer(("127.0.0.1", 0), dispatcher, loop)  # type: ignore[arg-type]
        transport, _ = await server.create_serve_endpoint()
        port = transport.get_extra_info("sockname")[1]
        what = config(f"vrchat://127.0.0.1:{port}", WS)
        async with running(what) as (_, places), reading(places[2]) as stream:
            sender = Sender(places[0])
            for row in range(100, 130, 10):
                got.clear()
                sender.send(sample_frame(row))
                found = await pose(stream)
                async with asyncio.timeout(PATIENCE):
                    while len(got) < 18:
                        came.clear()
                        await came.wait()
                for name, (joint, end) in _TRACKERS.items():
                    place = got[f"/tracking/trackers/{name}/position"]
                    wanted = found["positions"][KINECT_V1.index(joint)]
                    np.testing.assert_allclose(_MIRROR @ place, wanted, atol=1e-4)
                    turn = found["rotations"][KINECT_V1.index(end)]
                    ours = Rotation.from_quat(turn, scalar_first=True).as_matrix()
                    theirs = _unity(*got[f"/tracking/trackers/{name}/rotation"])
                    np.testing.assert_allclose(
                        _MIRROR @ theirs @ _MIRROR, ours, atol=1e-3
                    )
        transport.close()

    do(session())
