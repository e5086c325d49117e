"""What a skeleton tracker makes of what a Kinect sees: errors of place.

Each error has a cause: the tracker's own definition of joints, surfaces half hidden
or foreshortened, postures it was not taught, its wobble, the motion during one
exposure, the noise of the depth image, props taken for limbs.

A tracker's joints are not the joint centers of anatomy. How far they are off turns
with the segments that meet at the joint, so each constant offset has two parts, one
fixed to the segment that ends at the joint and one to the segment that starts there.
The numbers were fitted by ``tests/calibrate_kinect.py`` to a Kinect v2 beside marker
mocap (UI-PRMD, Vakanski et al. 2018, Data 3(1)), people s02, s03 and s04, left and
right taken together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from kinefilter.characters import STANDARD_HEIGHT, Body, Motion, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import rotate

from .geometry import Sensor, in_world_frame
from .visibility import Sight, rest_front

_FEATURES = 96  # random cosines: enough that no direction of posture is left out
_STARTS = 12.0  # time constants before the take, so that it starts in full swing
SAME = {
    "SpineBase": "HipCenter",
    "SpineMid": "Spine",
    "SpineShoulder": "ShoulderCenter",
    "Neck": "ShoulderCenter",
    "HandTip": "Hand",
    "Thumb": "Hand",
}
"""Names of Kinect v2 in the table, which has Kinect v1's. Neck, HandTip and Thumb are
guessed from the joint beside them."""

# Joint -> offset [cm] along the rest axes (left, up, forward) of the segment that ends
# at it, and of the one that starts there; its moving error against the mean of all
# joints, and the correlation of this error with that of the joint's parent. Spine and
# Hand are guessed from their neighbors. The moving errors were changed by hand where
# the sum of all errors was off: feet move least and would wobble too little, elbows
# move with their offsets too.
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
    """How far the tracker errs.

    All zero but ``mirrored_beyond``, which is pi: it sees the truth.

    Set by hand so that figures of ``tests/calibrate_kinect.py`` come near those of
    recordings, unless called a guess.
    """

    bias: float = 1.0
    """Share of the tracker's own definition of joints (``misplacements``), 1 as
    recorded."""
    bias_spread: float = 0.011
    """Standard deviation of that definition between people, along each axis of each
    segment [m]."""
    pull: float = 0.5
    """Share of the way to the center of what is seen of a part that a joint goes. A
    guess."""
    foreshortening: float = 0.1
    """Share of the way to the surface of a limb that points at the sensor that a joint
    goes. Recordings give -0.3 to 0.3, joint by joint: they show no more."""
    posture_error: float = 0.015
    """Standard deviation along each axis of a mean joint's error that comes back with
    the posture [m]: the tracker was not taught this person in it."""
    posture_scale: float = 0.8
    """Change of the posture after which that error is another: root of the sum of
    squares over the directions of all segments."""
    wobble: float = 0.047
    """Standard deviation along each axis of a mean joint's wandering error while it
    moves fast [m]."""
    calm: float = 0.12
    """Share of this wobble that is left while the joint is still."""
    stirring_speed: float = 0.5
    """Speed of a joint at which half of the rest of the wobble is there [m/s]."""
    wobble_time: float = 0.17
    """Time constant in which a wandering error is forgotten [s]."""
    burst: float = 1.5
    """Spread of the wobble's strength over time, standard deviation of its natural
    logarithm: most frames are calm, some jump."""
    burst_time: float = 0.15
    """Time constant of that strength [s]."""
    hidden_wobble: float = 2.0
    """How many times as much a joint wobbles more when nothing of it is seen."""
    blur: float = 0.004
    """Mean time by which what is measured lies behind the frame's time stamp [s]; it
    varies as much."""
    grain: float = 5.0
    """Number of neighboring pixels that share one error of depth."""
    prop: float = 0.5
    """Share of the way to a prop's surface, where it fills all surroundings of a
    joint, by which the joint is taken there. A guess."""
    doubt: float = 0.12
    """Standard deviation of what the tracker believes to see of a part, as a share of
    the part."""
    doubt_time: float = 0.3
    """Time constant of this doubt [s]."""
    trust: float = 0.0
    """What is added to the share of a part that must be believed seen for it to be
    tracked (``tracker_states``)."""
    merging: float = 0.2
    """Share of a part that is believed unseen when all its surroundings are at its own
    depth."""
    fast: float = 0.08
    """Share of a part that is believed unseen for each meter per second by which it
    moves against the trunk [s/m]: it is smeared over what lies behind."""
    guess: float = 1.0
    """Share of the way from the measurement to the tracker's guess that a joint of
    which nothing is seen goes."""
    guess_time: float = 0.8
    """Time constant in which a guess goes from where the joint was last seen, as seen
    from its parent, to where such joints mostly are [s]. A guess."""
    jump: float = 0.04
    """Standard deviation along each axis of the jump with which a guess may begin
    [m]. A guess."""
    swap_rate: float = 2.0
    """Rate at which limbs whose surroundings are all filled by the other side's are
    swapped [1/s]. A guess."""
    swap_time: float = 0.4
    """Mean time for which they stay swapped [s]. A guess."""
    mirrored_beyond: float = 2.0
    """Angle off facing the sensor from which a person is taken for one who faces it,
    left and right swapped [rad]; pi: never. Kinect's trackers assume that people face
    them."""


def _table(skeleton: Skeleton) -> list[tuple[_Offset, _Offset, float, float]]:
    stems = (j.removesuffix("Left").removesuffix("Right") for j in skeleton.joints)
    return [_JOINTS[SAME.get(stem, stem)] for stem in stems]


def misplacements(skeleton: Skeleton) -> Array:
    """Return constant offsets [m] in the frames of segments, shape (2, J, 3).

    First the part that turns with the segment that ends at the joint, then the part
    that turns with the segment that starts there; T-pose, facing +z.
    """
    table = np.array([row[:2] for row in _table(skeleton)])
    table[[j.endswith("Right") for j in skeleton.joints], :, 0] *= -1.0
    return np.asarray(0.01 * table.swapaxes(0, 1))


def unsteadiness(skeleton: Skeleton) -> Array:
    """Return each joint's moving error against the mean joint's, shape (J,)."""
    return np.array([row[2] for row in _table(skeleton)])


def kinship(skeleton: Skeleton) -> Array:
    """Return the matrix that makes independent errors those of one body, (J, J).

    Errors of unit variance keep it, and correlate with those of the parent.
    """
    mix, table = np.eye(len(skeleton)), _table(skeleton)
    for j in skeleton.segments:
        shared = table[j][3]
        mix[j] = shared * mix[skeleton.parents[j]]
        mix[j, j] = np.sqrt(1.0 - shared**2)
    return mix


def misplaced(
    motion: Motion,
    sight: Sight,
    sensor: Sensor,
    errors: TrackerErrors,
    *,
    rng: np.random.Generator,
    person: np.random.Generator,
) -> Array:
    """Return where the tracker puts joints that it sees [m], world, shape (T, J, 3).

    Args:
        motion: The truth.
        sight: What is seen of it.
        sensor: Its place, its noise of depth and pixels.
        errors: How far the tracker errs.
        rng: Draws what differs between takes.
        person: Draws what differs between people.
    """
    truth, body, fps = motion.positions, motion.body, motion.fps
    eye = in_world_frame(np.zeros(3), sensor)
    line = truth - eye
    depth = np.linalg.norm(line, axis=-1, keepdims=True)
    line = line / depth
    unsteady = unsteadiness(body.skeleton)[:, None]
    hidden = 1.0 - sight.visible[..., None]
    away = _bias(motion, errors, person) + errors.pull * sight.pull
    # That surfaces are before their joints as in a T-pose is what the tracker knows.
    nearer = sight.front - rest_front(body, sensor) * (sight.visible > 0.0)
    away -= errors.foreshortening * nearer[..., None] * line
    away += errors.posture_error * unsteady * _posture_error(motion, errors, person)
    stir = errors.calm + (1.0 - errors.calm) * _stir(truth, errors, fps)
    strength = errors.wobble * unsteady * stir * (1.0 + errors.hidden_wobble * hidden)
    away += _wander(strength, kinship(body.skeleton), errors, fps, rng)
    away += errors.prop * sight.prop[..., None] * sight.prop_pull
    if len(motion) > 1:
        late = errors.blur * (1.0 + slow_noise((*truth.shape[:2], 1), 0.1 * fps, rng))
        away -= late * np.gradient(truth, 1.0 / fps, axis=0)
    away += _pixel_noise(depth, line, sight, sensor, errors, body, rng)
    return np.asarray(truth + away)


def _bias(motion: Motion, errors: TrackerErrors, person: np.random.Generator) -> Array:
    """Misplacement by the tracker's definition of joints [m], (T, J, 3)."""
    skeleton = motion.skeleton
    offsets = misplacements(skeleton)
    own = kinship(skeleton) @ person.normal(size=offsets.shape)
    scale = motion.body.height / STANDARD_HEIGHT
    offsets = scale * errors.bias * offsets + errors.bias_spread * own
    after = [c[0] if c else j for j, c in enumerate(skeleton.children)]
    turn = motion.rotations
    return rotate(turn, offsets[0]) + rotate(turn[:, after], offsets[1])


def _posture_error(
    motion: Motion, errors: TrackerErrors, person: np.random.Generator
) -> Array:
    """A smooth random function of the posture, unit variance, (T, J, 3).

    Of a limb's joints: of the posture of trunk and limb. Random cosines of segment
    directions: a draw from a Gaussian process with a Gaussian kernel (Rahimi & Recht
    2007). The directions are the world's: the sensor sees a turned person as another
    posture.
    """
    skeleton = motion.skeleton
    parents = np.maximum(skeleton.parents, 0)
    bones = motion.positions - motion.positions[:, parents]
    bones /= np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-9)
    weights = person.normal(size=(_FEATURES, len(skeleton), 3))
    weights = np.sqrt(2.0 / _FEATURES) * (kinship(skeleton) @ weights)
    drawn = np.empty(bones.shape)
    for part, posture in _limb_and_trunk(skeleton):
        slopes = person.normal(size=(3 * len(posture), _FEATURES))
        phases = person.uniform(0.0, 2.0 * np.pi, _FEATURES)
        angles = bones[:, posture].reshape(len(bones), -1) @ slopes
        waves = np.cos(angles / max(errors.posture_scale, 1e-6) + phases)
        drawn[:, part] = np.tensordot(waves, weights[:, part], axes=1)
    return drawn


def _limb_and_trunk(skeleton: Skeleton) -> list[tuple[list[int], list[int]]]:
    """Joints of each limb and of the trunk, and those whose segments matter there."""
    tops = ("Elbow", "Knee")
    limbs = []
    for joint in skeleton.joints:
        if joint.startswith(tops):
            limb = [skeleton.index(joint)]
            for j in limb:
                limb.extend(skeleton.children[j])
            limbs.append(limb)
    far = {j for limb in limbs for j in limb}
    trunk = [j for j in range(len(skeleton)) if j not in far]
    return [(trunk, trunk), *((limb, limb + trunk) for limb in limbs)]


def _stir(truth: Array, errors: TrackerErrors, fps: float) -> Array:
    """How much a joint's speed makes it wobble, in [0, 1), (T, J, 1)."""
    if len(truth) < 2:
        return np.zeros((*truth.shape[:2], 1))
    velocity = np.gradient(truth, 1.0 / fps, axis=0)
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    return np.asarray(speed / (speed + max(errors.stirring_speed, 1e-6)))


def _wander(
    strength: Array,
    mix: Array,
    errors: TrackerErrors,
    fps: float,
    rng: np.random.Generator,
) -> Array:
    """An error that wanders off in bursts and is forgotten [m], (T, J, 3)."""
    frames, joints = strength.shape[:2]
    lead = int(_STARTS * errors.wobble_time * fps)
    strength = np.concatenate([np.repeat(strength[:1], lead, axis=0), strength])
    calm = mix @ slow_noise((lead + frames, joints, 1), errors.burst_time * fps, rng)
    # The mean square of the log-normal strength is one.
    force = np.exp(errors.burst * calm - errors.burst**2)
    kept = np.exp(-1.0 / max(errors.wobble_time * fps, 1e-6))
    pushes = mix @ rng.normal(size=(lead + frames, joints, 3)) * force * strength
    walk = lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], pushes, axis=0)
    return np.asarray(walk[lead:])


def _pixel_noise(
    depth: Array,
    line: Array,
    sight: Sight,
    sensor: Sensor,
    errors: TrackerErrors,
    body: Body,
    rng: np.random.Generator,
) -> Array:
    """Noise of the depth image, averaged over what is seen of a part [m], (T, J, 3)."""
    density = sensor.pixels(depth)
    area = np.pi * body.radii[:, None] ** 2 * sight.visible[..., None]
    count = np.maximum(density * area / max(errors.grain, 1.0), 1.0)
    across = np.sqrt(1.0 / (12.0 * density)) * min(errors.grain, 1.0)
    along = sensor.depth_noise.at(depth) * min(errors.grain, 1.0)
    noise = across * rng.normal(size=line.shape)
    noise += (along - across) * rng.normal(size=depth.shape) * line
    return np.asarray(noise / np.sqrt(count))


def slow_noise(shape: tuple[int, ...], steps: float, rng: np.random.Generator) -> Array:
    """Return noise of unit variance that forgets itself in ``steps`` frames.

    A first-order autoregressive process along axis 0 that starts in its steady state.
    """
    kept = np.exp(-1.0 / max(steps, 1e-6))
    pushes = np.sqrt(1.0 - kept**2) * rng.normal(size=shape)
    pushes[0] /= np.sqrt(1.0 - kept**2)
    return np.asarray(lfilter([1.0], [1.0, -kept], pushes, axis=0))
