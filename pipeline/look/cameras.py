"""Cameras for a motion."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinefilter.characters import InputError, Motion
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import rotate
from kinefilter.pipeline.formats.files import read_toml

_FOV = 28.0  # degrees, vertical: a normal lens, 48 mm on 35 mm film
# Degrees to the left of the character's heading, and up. Chosen by eye.
_DIRECTIONS = {"front": (0.0, 6.0), "side": (90.0, 6.0)}
_DIRECTIONS |= dict.fromkeys(("three-quarter", "orbit", "follow"), (35.0, 12.0))
_OVER = 35.0  # degrees up, so that sensors do not hide the person. Chosen by eye
CAMERAS = tuple(_DIRECTIONS)  # cameras that are placed automatically

_TURN = 12.0  # s, approximate duration of an orbit
_LAG = 0.5  # s over which a following camera averages the character's position
_AZIMUTHS = 24  # at which an orbit is checked to show everything
_FARTHEST = 1e6  # m from the origin, where single precision is already coarse
_MARGIN = 0.06  # of the picture, on each side


@dataclass(frozen=True, eq=False)
class CameraPath:
    """A camera in every frame, or one that stays where it is."""

    positions: Array  # [m], world frame, shape (T, 3), or (1, 3) if the camera stays
    targets: Array  # points in the middle of the picture [m], likewise
    fov: float  # vertical field of view [degrees]

    @property
    def stays(self) -> bool:
        """Whether the camera never moves."""
        return len(self.positions) == 1

    def at(self, frame: int) -> tuple[Array, Array]:
        """Return position and target in a frame."""
        k = 0 if self.stays else frame
        return self.positions[k], self.targets[k]

    @property
    def toward(self) -> Array:
        """Unit vector from the target to the camera, in the first frame."""
        away = self.positions[0] - self.targets[0]
        return np.asarray(away / np.linalg.norm(away))


def camera_path(
    camera: str, motion: Motion, points: Array, *, aspect: float, rate: float
) -> CameraPath:
    """Return one of CAMERAS, or the camera of a TOML file, for a motion.

    CAMERAS keep all points [m] (T, N, 3) in the picture; ``aspect`` is width over
    height, ``rate`` the frame rate [1/s]. Raises an InputError for an unknown camera.
    """
    if camera not in CAMERAS:
        return camera_of(camera)
    around, up = np.radians(_DIRECTIONS[camera])
    # At heading zero the character faces +z.
    headings = rotate(motion.rotations[:, motion.skeleton.root], [0.0, 0.0, 1.0])
    x, _, z = headings.mean(axis=0)
    azimuth = np.arctan2(x, z) + around
    toward = _direction(azimuth, up)
    if camera == "follow":
        from scipy.ndimage import gaussian_filter1d  # takes long to load

        targets = gaussian_filter1d(motion.root, _LAG * rate, axis=0, mode="nearest")
        low, high = points[..., 1].min(), points[..., 1].max()
        targets[:, 1] = 0.5 * (low + high)
        away = _distance(points - targets[:, None], toward, aspect)
        return CameraPath(targets + away * toward, targets, _FOV)
    flat = points.reshape(-1, 3)
    if camera != "orbit":
        return _still(flat, toward, aspect)
    target = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    turns = np.arange(_AZIMUTHS) / _AZIMUTHS * 2.0 * np.pi
    away = max(_distance(flat - target, _direction(a, up), aspect) for a in turns)
    count = len(motion)
    whole = max(1, round(count / rate / _TURN))
    angles = azimuth + 2.0 * np.pi * whole * np.arange(count) / count
    positions = target + away * np.stack([_direction(a, up) for a in angles])
    return CameraPath(positions, np.broadcast_to(target, positions.shape), _FOV)


def camera_over(points: Array, sensors: Array, *, aspect: float) -> CameraPath:
    """Return a still camera that looks down from the side of most sensors.

    It shows all points [m] (N, 3), which include the sensors [m] (S, 3).
    """
    x, _, z = (sensors - np.median(points, axis=0)).mean(axis=0)
    return _still(points, _direction(np.arctan2(x, z), np.radians(_OVER)), aspect)


def axes_toward(toward: Array) -> tuple[Array, Array]:
    """Return right and up of a picture, given the unit vector toward its camera."""
    right = np.cross([0.0, 1.0, 0.0], toward)
    right /= np.linalg.norm(right)
    return right, np.cross(toward, right)


def _direction(azimuth: float, elevation: float) -> Array:
    level, up = np.cos(elevation), np.sin(elevation)
    return np.array([level * np.sin(azimuth), up, level * np.cos(azimuth)])


def _still(points: Array, toward: Array, aspect: float) -> CameraPath:
    """Return a still camera with equal margins on opposite sides of points."""
    target = 0.5 * (points.min(axis=0) + points.max(axis=0))
    axes = axes_toward(toward)
    away = _distance(points - target, toward, aspect)
    for _ in range(4):  # each makes the difference of the margins a tenth
        offsets = points - target
        for axis in axes:
            edge = offsets @ axis / (away - offsets @ toward)
            target = target + 0.5 * away * (edge.max() + edge.min()) * axis
        away = _distance(points - target, toward, aspect)
    return CameraPath((target + away * toward)[None], target[None], _FOV)


def _distance(offsets: Array, toward: Array, aspect: float) -> float:
    """Return the distance [m] that shows all points (..., 3), relative to a target."""
    right, up = axes_toward(toward)
    half = np.tan(0.5 * np.radians(_FOV)) * (1.0 - 2.0 * _MARGIN)
    across = np.maximum(np.abs(offsets @ right) / aspect, np.abs(offsets @ up)) / half
    return float(np.max(offsets @ toward + across))


def camera_of(camera: str) -> CameraPath:
    """Return the camera of a TOML file, or raise an InputError."""
    path = Path(camera)
    if path.suffix != ".toml":
        raise InputError(
            f"--camera {camera}: expected {', '.join(CAMERAS)} or a .toml file"
        )
    table = read_toml(path, "write lines such as position = [0.0, 1.5, 4.0]")
    if unknown := ", ".join(sorted(set(table) - {"position", "target", "fov"})):
        raise InputError(f"{path}: unknown {unknown}; expected position, target, fov")
    for name in ("position", "target"):
        place = table.get(name)
        if not (isinstance(place, list) and len(place) == 3) or not all(
            isinstance(v, int | float) and abs(v) < _FARTHEST for v in place
        ):
            expected = "expected [x, y, z] in meters, y up"
            raise InputError(f"{path}: {name} is {place!r}; {expected}")
    position, target = np.array([table["position"], table["target"]], dtype=np.float64)
    fov = table.get("fov", _FOV)
    if not isinstance(fov, int | float) or not 1.0 <= fov <= 170.0:
        raise InputError(f"{path}: fov is {fov!r}; expected 1 to 170 degrees")
    if np.linalg.norm(np.cross(position - target, [0.0, 1.0, 0.0])) < 1e-3:
        raise InputError(
            f"{path}: the camera looks straight up or down, or at itself; move its "
            "position or target sideways"
        )
    return CameraPath(position[None], target[None], float(fov))
