"""The capsule humanoid: a MuJoCo model of a body that is pulled to a target posture.

It has one capsule per segment, attached to its parent by a ball joint; the root is
free. Bounded PD forces pull the end of every segment to a target point, and a bounded
torque turns it about its own axis (Shum 2013, section VII). Both are MuJoCo actuators,
so the engine evaluates them in every substep.

In MuJoCo's world, z is up and the character faces +x; scenes, physics and drawing use
it. ``to_mujoco`` and ``from_mujoco`` convert.
"""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from .anthropometry import GRAVITY, Body, joint_masses, joint_range
from .arrays import Array
from .errors import InputError
from .tracking import Tracking

PULLS = 30
"""Actuator group of everything that pulls the character; the next one's is 29, ..."""
MOST_CHARACTERS = 16
"""In one model: each needs an actuator group and a collision bit of its own."""

# A time constant of two steps, the stiffest that MuJoCo allows, and almost rigid.
_HARD = {"solref": [2.0 / 240.0, 1.0], "solimp": [0.95, 0.999, 0.001, 0.5, 2.0]}
# Flesh yields by some centimeters, and so must capsules where a tracker lets arms touch
# the trunk: hard ones would shake. The time constant is a guess.
_SOFT_FLESH = {"solref": [0.1, 1.0], "solimp": [0.1, 0.9, 0.03, 0.5, 2.0]}
# Thin capsules have almost no inertia about their axis, so a target that jumps spins
# them up. The armature is the inertia of a hand about the wrist; the damping of tissue
# stops a part within a tenth of a second. Without both, failed takes diverge.
_ARMATURE = 0.003  # kg m^2
_PASSIVE_DAMPING = 10.0  # 1/s
# A pelvis is one bone, although a Kinect sees its hips move. A leg that is pulled back
# and forth must not whirl the short lever that carries it. Chosen, from 10, 30 and 100,
# on walks of five people and half of the recorded takes.
_PELVIS_DAMPING = 100.0  # 1/s, times the leg's inertia about the pelvis
# Turning a segment about its axis also turns its descendants, which lie at an angle:
# the gains of the torque are for this share of its inertia across the axis. A guess.
_TWIST_INERTIA = 0.1
_HEEL = 0.03  # m from the middle of a heel to the two balls under it. A guess.
# Groups of parts, and the groups with which each collides.
_TRUNK = "Spine SpineMid ShoulderCenter SpineShoulder Neck Head KneeLeft KneeRight"
_GROUPS = {
    "left arm": ("WristLeft HandLeft HandTipLeft ThumbLeft", ["right arm"]),
    "right arm": ("WristRight HandRight HandTipRight ThumbRight", []),
    "left leg": ("AnkleLeft FootLeft", ["left arm", "right arm", "right leg"]),
    "right leg": ("AnkleRight FootRight", ["left arm", "right arm"]),
    "trunk": (_TRUNK, ["left arm", "right arm"]),
}
_BITS = {group: 1 << bit for bit, group in enumerate(_GROUPS, start=1)}
FLOOR_BIT = 1 << 6  # collision bit of the floor where there are several characters
_FIRST_BIT = 7  # of the characters' own
# What people touch each other with: a trunk yields by some centimeters before it moves.
# Guesses.
_FIRM_FLESH = {"solref": [0.04, 1.0], "solimp": [0.5, 0.98, 0.03, 0.5, 2.0]}
_UNSEEN = 4  # group of geoms that nothing draws
# Order of the components of vectors and quaternions: (forward, left, up) is (z, x, y).
_TO_MUJOCO = {3: np.array([2, 0, 1]), 4: np.array([0, 3, 1, 2])}
_FROM_MUJOCO = {3: np.array([1, 2, 0]), 4: np.array([0, 2, 3, 1])}


def to_mujoco(values: Array) -> Array:
    """Convert vectors (..., 3) or quaternions wxyz (..., 4) to MuJoCo's z-up world."""
    return values.take(_TO_MUJOCO[values.shape[-1]], axis=-1)


def from_mujoco(values: Array) -> Array:
    """Convert vectors (..., 3) or quaternions wxyz (..., 4) to kinefilter's world."""
    return values.take(_FROM_MUJOCO[values.shape[-1]], axis=-1)


def build_humanoid(body: Body, tracking: Tracking | None = None) -> mujoco.MjSpec:
    """Return the capsule humanoid of a body standing in T-pose on a floor.

    Bodies, ball joints and sites are named after the joint at which a segment ends; the
    site marks that joint. Actuators are in the skeleton's order of joints: first three
    forces per joint (MuJoCo x, y, z), then three torques for the root and one for every
    other segment, which follow the orientation of the mocap body ``target:NAME``.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "kinefilter"
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    spec.option.timestep = 1.0 / 240.0
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    world, plane = spec.worldbody, mujoco.mjtGeom.mjGEOM_PLANE
    world.add_geom(name="floor", type=plane, size=[0.0, 0.0, 1.0], **_HARD)
    world.add_site(name="world")
    _add_bodies(spec, body)
    _add_pulls(spec, body, tracking or Tracking())
    for joint in body.skeleton.joints:
        target = world.add_body(name=f"target:{joint}", mocap=True)
        target.add_site(name=f"target:{joint}")
    return spec


def prefix_of(number: int) -> str:
    """Return what the names of a character's parts begin with, by its number from 0."""
    return f"{number + 1}:" if number else ""


def build_humanoids(
    bodies: Sequence[Body], tracking: Tracking | None = None
) -> mujoco.MjSpec:
    """Return the humanoids of several bodies, all in T-pose at the origin of a floor.

    The first is that of ``build_humanoid``. The names of the others begin with
    ``prefix_of(number)``, and their actuators have the group PULLS - number. All parts
    of one collide with those of others. Raises InputError beyond MOST_CHARACTERS.
    """
    if not 1 <= len(bodies) <= MOST_CHARACTERS:
        raise InputError(
            f"{len(bodies)} characters in one scene; at most {MOST_CHARACTERS} fit"
        )
    spec = build_humanoid(bodies[0], tracking)
    if len(bodies) == 1:
        return spec
    for number, body in enumerate(bodies):
        one = build_humanoid(body, tracking) if number else spec
        floor = one.geom("floor")
        for geom in [geom for geom in one.geoms if geom.name != floor.name]:
            _add_firm_flesh(geom, number, len(bodies))
            geom.conaffinity |= FLOOR_BIT
        for pull in one.actuators:
            pull.group = PULLS - number
        if number:
            one.delete(floor)
            spec.attach(one, frame=spec.worldbody.add_frame(), prefix=prefix_of(number))
    spec.geom("floor").contype |= FLOOR_BIT
    return spec


def _add_firm_flesh(geom: mujoco.MjsGeom, number: int, count: int) -> None:
    """Add a geom of the same shape that only those of the other characters touch."""
    own = 1 << (_FIRST_BIT + number)
    everyone = ((1 << count) - 1) << _FIRST_BIT
    shape = {key: getattr(geom, key) for key in ("type", "size", "pos", "fromto")}
    bits = {"contype": own, "conaffinity": everyone & ~own, "group": _UNSEEN}
    name = f"{geom.name}:firm"
    geom.parent.add_geom(name=name, mass=0.0, **shape, **bits, **_FIRM_FLESH)


def _add_bodies(spec: mujoco.MjSpec, body: Body) -> None:
    skeleton, root = body.skeleton, body.skeleton.root
    offsets = to_mujoco(body.rest_offsets)
    damping = _PASSIVE_DAMPING * _swing_inertias(body)
    for hip in skeleton.hips:
        leg = float(body.masses[skeleton.descendants(int(hip))].sum())
        damping[hip] += _PELVIS_DAMPING * leg * body.lengths[hip] ** 2
    parts: dict[int, mujoco.MjsBody] = {}
    for j in skeleton.order:
        name, p = skeleton.joints[j], skeleton.parents[j]
        flesh: dict[str, Any] = {
            "size": [body.radii[j], 0.0, 0.0],
            "solmix": 1e-3,  # the hardness of the floor or prop prevails
            # Limbs slide along the body, without friction: those whose target passes
            # through it would stick, then leap. Floor and props keep theirs.
            "condim": 1,
            **_SOFT_FLESH,
        }
        if j == root:
            rest_root = to_mujoco(body.rest_positions[root])
            parts[j] = spec.worldbody.add_body(name=name, pos=rest_root)
            parts[j].add_freejoint(name=name)
            shape = {"type": mujoco.mjtGeom.mjGEOM_SPHERE}
        else:
            parts[j] = parts[p].add_body(name=name, pos=offsets[p])
            parts[j].add_joint(
                name=name,
                type=mujoco.mjtJoint.mjJNT_BALL,
                armature=_ARMATURE,
                range=[0.0, np.degrees(joint_range(name))],
                solref_limit=_HARD["solref"],
                solimp_limit=_HARD["solimp"],
                damping=[damping[j], 0.0, 0.0],
            )
            shape = {"type": mujoco.mjtGeom.mjGEOM_CAPSULE}
            shape["fromto"] = [0.0, 0.0, 0.0, *offsets[j]]
        mass, bits = body.masses[j], _collisions(name)
        parts[j].add_geom(name=name, mass=mass, **shape, **bits, **flesh)
        parts[j].add_site(name=name, pos=offsets[j])
        if name.startswith("Foot"):
            # Only the toes of a capsule from ankle to toes would touch the floor; on
            # toes and a single ball it would roll like a wheel.
            height = float(body.rest_positions[p, 1] - body.radii[j])
            heel, bits = name.replace("Foot", "Heel"), _collisions("")
            for k, aside in enumerate((_HEEL, -_HEEL)):
                ball = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "mass": 0.0, **bits}
                pos = [0.0, aside, -height]
                parts[j].add_geom(name=f"{heel}:{k}", pos=pos, **ball, **flesh)


def _collisions(name: str) -> dict[str, int]:
    """Return MuJoCo's collision bits of the segment that ends at a joint.

    All segments collide with the floor and with props. Hands and forearms collide with
    each other, the trunk, the head and the legs; lower legs collide with each other.
    Segments that meet at shoulders and hips overlap anyway.
    """
    for group, (parts, others) in _GROUPS.items():
        if name in parts.split():
            bits = sum(_BITS[other] for other in others)
            return {"contype": _BITS[group], "conaffinity": 1 | bits}
    return {"contype": 0, "conaffinity": 1}


def _add_pulls(spec: mujoco.MjSpec, body: Body, tracking: Tracking) -> None:
    """Add the actuators that pull the joints and twist the segments.

    There is one Cartesian PD actuator per axis and joint (Shum 2013, eq. 16): with
    ctrl = kp p_target + kv v_target, force = kp (p_target - p) + kv (v_target - v),
    clipped so that the vector stays within the bound. Torques act about each segment's
    axis, and about all axes of the root (eq. 17).
    """
    skeleton = body.skeleton
    for joint, mass in zip(skeleton.joints, joint_masses(body), strict=True):
        for axis in range(3):
            name = f"pull:{joint}:{'xyz'[axis]}"
            pull = spec.add_actuator(name=name, target=joint, refsite="world")
            pull.gear = np.eye(6)[axis]
            bound = mass * tracking.largest_acceleration / np.sqrt(3.0)
            _set_gains(pull, mass, tracking.natural_frequency, bound)
    inertias = _TWIST_INERTIA * _swing_inertias(body)
    # The pelvis carries the hips, each on a lever of its own length.
    hips = np.array(skeleton.children[skeleton.root])
    inertias[skeleton.root] += float(body.masses[hips] @ body.lengths[hips] ** 2) / 3.0
    axes = to_mujoco(body.rest_offsets)
    for j, joint in enumerate(skeleton.joints):
        turns = np.eye(3) if j == skeleton.root else [axes[j] / np.linalg.norm(axes[j])]
        for k, direction in enumerate(turns):
            name, site = f"turn:{joint}:{k}", f"target:{joint}"
            turn = spec.add_actuator(name=name, target=joint, refsite=site)
            turn.gear = [0.0, 0.0, 0.0, *direction]
            bound = inertias[j] * tracking.largest_angular_acceleration
            _set_gains(turn, inertias[j], tracking.twist_frequency, bound)


def _swing_inertias(body: Body) -> Array:
    """Return the inertia of each segment about its start [kg m^2], shape (J,)."""
    return np.asarray(body.masses * body.lengths**2 / 3.0 + _ARMATURE)


def _set_gains(
    actuator: mujoco.MjsActuator, inertia: float, frequency: float, bound: float
) -> None:
    """Make an actuator a critically damped PD controller with a bounded output."""
    actuator.trntype = mujoco.mjtTrn.mjTRN_SITE
    actuator.group = PULLS
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.biasprm[1:3] = [-inertia * frequency**2, -2.0 * inertia * frequency]
    actuator.forcelimited = True
    actuator.forcerange = [-bound, bound]
