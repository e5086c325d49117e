"""What a live session is to do."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import UseAppendAction, arg

from kinefilter.characters import InputError, TrackingName

MOST_BODIES = 6
"""People at once: as many as a Kinect v2 sees."""


@dataclass(frozen=True)
class AccessConfig:
    """Who may connect."""

    bind: str | None = None
    """Listen on this address of the machine instead of on loopback, so that others can
    connect. WebSockets then ask for a token."""
    token_file: Path | None = None
    """File with the token that clients of WebSockets have to send, as Authorization:
    Bearer or as ?token= of the address; default: with --bind a new one, which is
    printed."""
    certificate: Path | None = None
    """Certificate chain (PEM) of encrypted WebSockets (wss)."""
    key: Path | None = None
    """The certificate's private key (PEM); default: in the same file."""
    origin: UseAppendAction[tuple[str, ...]] = ()
    """Also let web pages of this origin connect, such as https://studio.example,
    besides those of this machine; may be given several times."""


@dataclass(frozen=True)
class LiveConfig:
    """Where frames come from, who is in them, and where poses go."""

    sources: UseAppendAction[
        Annotated[tuple[str, ...], arg(name="in", metavar="ADDRESS")]
    ]
    """Where to listen for frames: udp://HOST:PORT, ws://HOST:PORT, wss://HOST:PORT, or
    - for the standard input; may be given once for each of several sensors before the
    same people, the one whose frames come last first."""
    out: UseAppendAction[Annotated[tuple[str, ...], arg(metavar="ADDRESS")]]
    """Where to send poses: vmc://HOST:PORT for an engine, ws://HOST:PORT or
    wss://HOST:PORT to listen for browsers, or - for the standard output; may be given
    several times."""
    record: Path | None = None
    """Also write the raw frames to this take (.csv); for several bodies to take.1.csv,
    take.2.csv and so on, of several sensors to take.sensor1.csv and so on."""
    calibration: Path | None = None
    """Where the sensors are, from 'merge --save-calibration'; default: found while
    somebody walks to and fro."""
    skeleton: Literal["kinect_v1", "kinect_v2"] = "kinect_v2"
    """The joints of the frames."""
    scene: str | None = None
    """Surroundings of each person, who is alone in them: a scene (an unknown name lists
    the scenes), or an MJCF file (.xml); default: only the floor."""
    tracking: TrackingName = "faithful"
    """How each person's character follows: faithful; game, which gives way to what it
    meets, falls and gets up again; or ragdoll, which nothing pulls."""
    height: float | None = None
    """Height of every person [m]; default: each is measured in the first second."""
    mass: float | None = None
    """Mass of every person [kg]; default: estimated from the height."""
    floor: float | None = None
    """Height of the floor in the sensor's frame [m]; default: under the feet."""
    bodies: int = MOST_BODIES
    """How many people are followed at once."""

    def __post_init__(self) -> None:
        if self.floor is not None and not isfinite(self.floor):
            raise InputError(f"--floor {self.floor:g}: expected a height in meters")
