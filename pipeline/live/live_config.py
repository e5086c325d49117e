"""Settings of a live session."""

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import UseAppendAction, arg

from kinefilter.characters import InputError, TrackingName


@dataclass(frozen=True)
class AccessConfig:
    """Who may connect to a live session."""

    bind: str | None = None
    """Listen on this address of the machine instead of on loopback, so that other
    machines can connect. WebSocket clients then need a token."""
    token_file: Path | None = None
    """File with the token that WebSocket clients must send, as 'Authorization: Bearer
    TOKEN' or as ?token=TOKEN in the address; default: with --bind, a new token is made
    and printed."""
    certificate: Path | None = None
    """Certificate chain (PEM) for encrypted WebSockets (wss)."""
    key: Path | None = None
    """Private key of the certificate (PEM); default: read from the certificate file."""
    origin: UseAppendAction[tuple[str, ...]] = ()
    """Also allow web pages from this origin, such as https://studio.example, besides
    those that this machine serves; may be given several times. null allows pages opened
    as files, as which pages of other sites can pose."""


@dataclass(frozen=True)
class LiveConfig:
    """Where frames come from, how people are followed, and where poses go."""

    sources: UseAppendAction[
        Annotated[tuple[str, ...], arg(name="in", metavar="ADDRESS")]
    ]
    """Where to listen for frames: udp://HOST:PORT, ws://HOST:PORT or wss://HOST:PORT;
    or standard input with -. If several sensors see the same people, give it once per
    sensor, starting with the sensor whose frames arrive last."""
    out: UseAppendAction[Annotated[tuple[str, ...], arg(metavar="ADDRESS")]]
    """Where to send poses: vmc://HOST:PORT for an engine that takes VMC,
    vrchat://HOST:PORT for VRChat's OSC trackers (port 9000), ws://HOST:PORT or
    wss://HOST:PORT to accept connections from browsers, or - for standard output; may
    be given several times."""
    record: Path | None = None
    """Also record the raw frames to this take (.csv). Several bodies are written to
    take.1.csv, take.2.csv and so on; several sensors to take.sensor1.csv and so on."""
    calibration: Path | None = None
    """Where the sensors are, from 'merge --save-calibration'; default: found while
    someone walks back and forth in view of all sensors."""
    skeleton: Literal["kinect_v1", "kinect_v2"] = "kinect_v2"
    """Skeleton whose joints the frames contain."""
    method: Literal["default", "local-pca", "none"] = "default"
    """Correction method, as for clean. The default is for a Kinect's joints and moves
    those of other trackers by centimeters; use local-pca for them."""
    scene: str | None = None
    """Surroundings that all people share, who push each other and the props: the name
    of a scene (an unknown name lists the scenes) or an MJCF file (.xml); default: only
    a floor, on which everyone is alone."""
    tracking: TrackingName = "faithful"
    """How each person's character follows the motion: faithful; game, which gives way
    to obstacles, falls, and gets up again; or ragdoll, which nothing pulls."""
    height: float | None = None
    """Height of every person [m]; default: each is measured in the first second."""
    mass: float | None = None
    """Mass of every person [kg]; default: estimated from the height."""
    floor: float | None = None
    """Height of the floor in the sensor frame [m]; default: under the feet."""
    bodies: int = 6  # as many as a Kinect v2 tracks
    """How many people are followed at once, from 1 to 32."""

    def __post_init__(self) -> None:
        if self.floor is not None and not isfinite(self.floor):
            raise InputError(f"--floor {self.floor:g}: expected a height in meters")
