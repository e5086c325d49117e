"""Position errors of the modeled tracker.

They come from the tracker's own definition of joints, surfaces that are partly hidden
or foreshortened, unfamiliar postures, its wobble, motion during the exposure, noise of
the depth image, props taken for limbs, and people seen from the side.

Each constant offset of its joints has one part that turns with the segment that ends at
the joint and one with the segment that starts there. ``tests/calibrate_kinect.py``
fitted them to a Kinect v2 beside marker mocap (UI-PRMD, Vakanski et al. 2018, Data
3(1)), people s02, s03 and s04, with left and right pooled.
"""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.signal import lfilter

from kinefilter.characters import KINECT_V2, STANDARD_HEIGHT, Motion, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import about_y, rotate, unit

from .geometry import Sensor, in_world_frame
from .visibility import Sight, rest_front

_FEATURES = 96  # random cosines: enough to cover all directions of posture
_TURNED = 0.2  # rad from the sensor up to which trunks are shown as they are
_SIDE_ON = 0.2  # rad around a right angle in which it takes fronts for backs
_WARM_UP = 12.0  # time constants before the take, so that it starts in the steady state
V1_NAMES = {
    "SpineBase": "HipCenter",
    "SpineMid": "Spine",
    "SpineShoulder": "ShoulderCenter",
    "Neck": "ShoulderCenter",
    "HandTip": "Hand",
    "Thumb": "Hand",
}
"""Kinect v1's joints, which the table has, by Kinect v2's. Neck, HandTip and Thumb get
the values of the joint beside them, a guess."""

# Per joint: offsets [cm] along the rest axes (left, up, forward) of the segment that
# ends at it and of the one that starts there; size of its varying error relative to the
# mean joint's; correlation of this error with that of the joint's parent. Spine and
# Hand are guessed from their neighbors. Some sizes were adjusted by hand where the sum
# of all errors was off: feet move least and would wobble too little, and the offsets
# already move the elbows.
_Offset = tuple[float, float, float]
_JOINTS: dict[str, tuple[_Offset, _Offset, float, float]] = {
    "HipCenter": ((0.0, -2.3, -1.9), (0.0, -0.4, -1.9), 0.8, 0.0),
    "Spine": ((0.0, -2.3, 0.0), (0.0, -1.1, -1.4), 0.7, 0.6),
    "ShoulderCenter": ((0.0, -4.1, 0.6), (0.0, 2.4, -2.4), 0.56, 0.6),
    "Head": ((0.0, -0.3, -2.0), (0.0, -0.3, -2.0), 0.6, 0.64),
    "Shoulder": ((0.1, 1.6, 1.7), (1.5, -3.2, 0.1), 0.66, 0.35),
    "Elbow": ((-2.6, -0.7, 0.9), (2.2, -2.4, 0.7), 0.82, 0.35),
    "Wrist": ((-0.1, 0.3, -0.4), (-0.1, 0.3, -0.4), 0.95, 0.51),
    "Hand": ((-0.1, 0.3, -0.4), (-0.1, 0.3, -0.4), 1.1, 0.7),
    "Hip": ((-1.9, -2.1, -0.2), (-0.3, 0.2, -0.7), 0.75, 0.88),
    "Knee": ((0.1, 3.2, 1.7), (0.2, -0.1, -1.1), 1.0, 0.08),
    "Ankle": ((0.8, 4.8, -0.5), (-0.2, 1.7, 0.8), 1.6, 0.33),
    "Foot": ((-0.2, 1.6, -1.8), (-0.2, 1.6, -1.8), 2.2, 0.78),
}


@dataclass(frozen=True)
class TrackerErrors:
    """Sizes of the modeled tracker's errors.

    With all values zero except ``mirrored_beyond``, which is then pi, the tracker
    reports the ground truth. The defaults were set by hand toward the figures of
    ``tests/calibrate_kinect.py`` for recordings, unless called a guess.
    """

    bias: float = 1.0  # factor on ``joint_offsets``, 1 as recorded
    bias_spread: float = 0.011  # deviation of these between people, per axis [m]
    pull: float = 0.5  # share of the way to the visible surface's center; a guess
    foreshortening: float = 0.1
    """Share of the way that a joint moves toward the surface of a limb that points at
    the sensor. Recordings give -0.3 to 0.3 depending on the joint, no clearer value."""
    posture_error: float = 0.015  # deviation per axis that recurs with a posture [m]
    posture_scale: float = 0.8  # change of directions that decorrelates it, norm
    wobble: float = 0.047  # deviation of the mean joint in fast motion, per axis [m]
    calm: float = 0.12  # share of this wobble that remains when the joint is still
    stirring_speed: float = 0.5  # m/s, at which half of the rest appears
    wobble_time: float = 0.17  # time constant of the wobble's autocorrelation [s]
    burst: float = 1.5  # deviation over time of the logarithm of its strength
    burst_time: float = 0.15  # time constant of that strength [s]
    hidden_wobble: float = 2.0  # increase for a hidden joint, times the wobble
    blur: float = 0.004  # mean and deviation of lags behind time stamps [s]
    grain: float = 5.0  # number of neighboring pixels that share one depth error
    trunk_turn: float = 0.41
    """How much farther people have turned than Kinect v2 shows hips, shoulders and the
    foot behind the body, as a share of the angle shown beyond ``_TURNED``. From
    people in front of two sensors (``turn_share_`` of the learned correction)."""
    prop: float = 0.5  # share of the way to props that fill all around; a guess
    doubt: float = 0.12  # deviation of the tracker's error in the visible share
    doubt_time: float = 0.3  # time constant of that error [s]
    trust: float = 0.0  # extra visible share that a joint needs to be tracked
    merging: float = 0.2  # visible share lost among surroundings as deep
    fast: float = 0.08  # visible share lost to motion blur, per relative speed [s/m]
    guess: float = 1.0  # share of the way from a hidden joint to its guess
    guess_time: float = 0.8  # s, for guesses to drift to usual positions; a guess
    jump: float = 0.04  # deviation of a guess's first jump, per axis [m]; a guess
    swap_rate: float = 2.0  # 1/s, among limbs of the other side alone; a guess
    swap_time: float = 0.4  # s, mean duration of a swap; a guess
    mirrored_beyond: float = 2.0  # rad off the sensor from which sides swap; pi: never


def _table(skeleton: Skeleton) -> list[tuple[_Offset, _Offset, float, float]]:
    return [_JOINTS[V1_NAMES.get(kind, kind)] for kind in skeleton.kinds]


def joint_offsets(skeleton: Skeleton) -> Array:
    """Return constant offsets [m], before and after the joint, at rest, (2, J, 3)."""
    table = np.array([row[:2] for row in _table(skeleton)])
    table[[j.endswith("Right") for j in skeleton.joints], :, 0] *= -1.0
    return np.asarray(0.01 * table.swapaxes(0, 1))


def error_scales(skeleton: Skeleton) -> Array:
    """Return the size of each joint's varying error relative to the mean, (J,)."""
    return np.array([row[2] for row in _table(skeleton)])


def error_mixing(skeleton: Skeleton) -> Array:
    """Return the matrix (J, J) that correlates unit errors with their parents'."""
    mixing, table = np.eye(len(skeleton)), _table(skeleton)
    for j in skeleton.segments:
        correlation = table[j][3]
        mixing[j] = correlation * mixing[skeleton.parents[j]]
        mixing[j, j] = np.sqrt(1.0 - correlation**2)
    return mixing


def with_position_errors(
    motion: Motion,
    sight: Sight,
    sensor: Sensor,
    errors: TrackerErrors,
    rng: Generator,
    person: Generator,
) -> Array:
    """Return where the tracker places joints [m], world frame, shape (T, J, 3).

    ``rng`` draws what differs between takes, ``person`` what differs between people.
    """
    truth, fps = motion.positions, motion.fps
    line = unit(truth - in_world_frame(np.zeros(3), sensor))
    scales = error_scales(motion.skeleton)[:, None]
    away = _bias(motion, errors, person) + errors.pull * sight.pull
    # The tracker accounts for how far surfaces are in front of joints in a T-pose.
    nearer = sight.front - rest_front(motion.body, sensor) * (sight.visible > 0.0)
    away -= errors.foreshortening * nearer[..., None] * line
    away += errors.posture_error * scales * _posture_error(motion, errors, person)
    velocity = velocities(truth, fps)
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    stir = speed / (speed + max(errors.stirring_speed, 1e-6))
    stir = errors.calm + (1.0 - errors.calm) * stir
    hidden = 1.0 - sight.visible[..., None]
    strength = errors.wobble * scales * stir * (1.0 + errors.hidden_wobble * hidden)
    away += _wobble(strength, motion, errors, rng)
    away += errors.prop * sight.prop[..., None] * sight.prop_pull
    if len(motion) > 1:
        late = errors.blur * (1.0 + slow_noise((*truth.shape[:2], 1), 0.1 * fps, rng))
        away -= late * velocity
    away += _pixel_noise(motion, sight, sensor, errors, rng)
    return _turned_toward(truth + away, motion, sensor, errors)


def _bias(motion: Motion, errors: TrackerErrors, person: Generator) -> Array:
    skeleton = motion.skeleton
    offsets = joint_offsets(skeleton)
    own = error_mixing(skeleton) @ person.normal(size=offsets.shape)
    scale = motion.body.height / STANDARD_HEIGHT
    offsets = scale * errors.bias * offsets + errors.bias_spread * own
    after = [c[0] if c else j for j, c in enumerate(skeleton.children)]
    turn = motion.rotations
    return rotate(turn, offsets[0]) + rotate(turn[:, after], offsets[1])


def _turned_toward(
    placed: Array, motion: Motion, sensor: Sensor, errors: TrackerErrors
) -> Array:
    """Return the joints (T, J, 3) with the trunk turned toward a Kinect v2."""
    skeleton, root = motion.skeleton, motion.skeleton.root
    if skeleton != KINECT_V2:
        return placed
    to_sensor = in_world_frame(np.zeros(3), sensor) - motion.positions[:, root]
    left = rotate(motion.rotations[:, root], np.array([1.0, 0.0, 0.0]))
    across = np.sum(left[:, [0, 2]] * to_sensor[:, [0, 2]], axis=1)
    ahead = left[:, 0] * to_sensor[:, 2] - left[:, 2] * to_sensor[:, 0]
    angle = np.arctan2(np.abs(across), np.abs(ahead))
    turn = np.maximum(angle - _TURNED, 0.0) * (1.0 - 1.0 / (1.0 + errors.trunk_turn))
    turn *= np.sign(across) * np.sign(ahead)
    turn *= np.minimum((np.pi / 2.0 - angle) / _SIDE_ON, 1.0)
    turned, around = placed.copy(), about_y(turn)[:, None]
    for pair in (list(skeleton.sides("Shoulder")), list(skeleton.sides("Hip"))):
        middle = placed[:, pair].mean(axis=1, keepdims=True)
        turned[:, pair] = middle + rotate(around, placed[:, pair] - middle)
    for foot, side in zip(skeleton.sides("Foot"), (1.0, -1.0), strict=True):
        ankle = placed[:, skeleton.parents[foot]]
        far = about_y(np.where(side * across < 0.0, turn, 0.0))
        turned[:, foot] = ankle + rotate(far, placed[:, foot] - ankle)
    return turned


def _posture_error(motion: Motion, errors: TrackerErrors, person: Generator) -> Array:
    """A smooth random function of the posture, unit variance, (T, J, 3).

    It is drawn from a Gaussian process as a sum of random cosines of segment directions
    (Rahimi & Recht 2007) in the world frame, because a turned person is another posture
    to the sensor. In the joints of a limb it depends on trunk and limb, in all others
    on the trunk.
    """
    skeleton = motion.skeleton
    parents = np.maximum(skeleton.parents, 0)
    bones = unit(motion.positions - motion.positions[:, parents])
    weights = person.normal(size=(_FEATURES, len(skeleton), 3))
    weights = np.sqrt(2.0 / _FEATURES) * (error_mixing(skeleton) @ weights)
    error = np.empty(bones.shape)
    tops = skeleton.sides("Elbow") + skeleton.sides("Knee")
    limbs = [[top, *skeleton.descendants(top)] for top in tops]
    trunk = [j for j in range(len(skeleton)) if not any(j in limb for limb in limbs)]
    for part, posture in [(trunk, trunk), *((limb, limb + trunk) for limb in limbs)]:
        slopes = person.normal(size=(3 * len(posture), _FEATURES))
        phases = person.uniform(0.0, 2.0 * np.pi, _FEATURES)
        angles = bones[:, posture].reshape(len(bones), -1) @ slopes
        waves = np.cos(angles / max(errors.posture_scale, 1e-6) + phases)
        error[:, part] = np.tensordot(waves, weights[:, part], axes=1)
    return error


def _wobble(
    strength: Array, motion: Motion, errors: TrackerErrors, rng: Generator
) -> Array:
    """Autocorrelated random error with bursts [m], (T, J, 3)."""
    fps, mixing = motion.fps, error_mixing(motion.skeleton)
    lead = int(_WARM_UP * errors.wobble_time * fps)
    strength = np.concatenate([np.repeat(strength[:1], lead, axis=0), strength])
    log = mixing @ slow_noise(strength.shape, errors.burst_time * fps, rng)
    # This log-normal factor has a mean square of one.
    factor = np.exp(errors.burst * log - errors.burst**2)
    kept = np.exp(-1.0 / max(errors.wobble_time * fps, 1e-6))
    pushes = mixing @ rng.normal(size=(*strength.shape[:2], 3)) * factor * strength
    walk = lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], pushes, axis=0)
    return np.asarray(walk[lead:])


def _pixel_noise(
    motion: Motion, sight: Sight, sensor: Sensor, errors: TrackerErrors, rng: Generator
) -> Array:
    """Noise of the depth image, averaged over the visible part [m], (T, J, 3)."""
    line = motion.positions - in_world_frame(np.zeros(3), sensor)
    depth = np.linalg.norm(line, axis=-1, keepdims=True)
    density = sensor.pixels(depth)
    area = np.pi * motion.body.radii[:, None] ** 2 * sight.visible[..., None]
    count = np.maximum(density * area / max(errors.grain, 1.0), 1.0)
    across = np.sqrt(1.0 / (12.0 * density)) * min(errors.grain, 1.0)
    along = sensor.depth_noise.at(depth) * min(errors.grain, 1.0)
    noise = across * rng.normal(size=line.shape)
    noise += (along - across) * rng.normal(size=depth.shape) * unit(line)
    return np.asarray(noise / np.sqrt(count))


def velocities(positions: Array, fps: float) -> Array:
    """Return the velocities of joints (T, J, 3) [m/s], zero for a single frame."""
    if len(positions) < 2:
        return np.zeros_like(positions)
    return np.asarray(np.gradient(positions, 1.0 / fps, axis=0))


def slow_noise(shape: tuple[int, ...], steps: float, rng: Generator) -> Array:
    """Return autoregressive unit noise of a time constant of ``steps`` frames."""
    kept = np.exp(-1.0 / max(steps, 1e-6))
    pushes = np.sqrt(1.0 - kept**2) * rng.normal(size=shape)
    pushes[0] /= np.sqrt(1.0 - kept**2)
    return np.asarray(lfilter([1.0], [1.0, -kept], pushes, axis=0))
