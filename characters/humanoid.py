"""The capsule humanoid: a body as a MuJoCo model that a target posture can pull.

One capsule per segment, each hanging from its parent by a ball joint, the root free.
Bounded PD forces pull the end of every segment to a target point and a bounded torque
turns it about its own axis (Shum 2013, section VII); both are MuJoCo actuators, so the
engine evaluates them in every substep.

MuJoCo's world is z up with the character facing +x. It begins at ``to_mujoco`` and ends
at ``from_mujoco``: scenes, physics and drawing work in it between them.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from .anthropometry import GRAVITY, Body, joint_masses, joint_range
from .arrays import Array
from .tracking import Tracking

PULLS = 30
"""Actuator group of everything that pulls the character."""

# Time constant of two steps, the stiffest that MuJoCo allows, and next to no give.
_HARD_FLOOR = ([2.0 / 240.0, 1.0], [0.95, 0.999, 0.001, 0.5, 2.0])
# Flesh gives way by some centimeters, and so must capsules where a tracker lets arms
# touch the trunk: hard ones would shake. How fast it does is a guess.
_SOFT_FLESH = ([0.1, 1.0], [0.1, 0.9, 0.03, 0.5, 2.0])
# Thin capsules have next to no inertia about their axis, and a jumping target spins
# them up: the inertia of a hand about the wrist, and a tissue damping that takes a
# tenth of a second to stop a part. Both tried: without, failed takes diverge.
_ARMATURE = 0.003  # kg m^2
_PASSIVE_DAMPING = 10.0  # 1/s
# Turning a segment about its axis turns what hangs on it, at an angle: the share of its
# inertia across the axis that the torque's gains are made for. A guess.
_TURNED_ALONG = 0.1
# A hand presses on a thing between two hands about as hard as on a heavy shopping bag's
# handle, and fingers reach around a corner. Both are guesses.
_GRIP = 100.0  # N
_REACH = 0.03  # m

# Parts by what they collide with, and which groups those are.
_ARM, _LEG = ("Wrist", "Hand", "HandTip", "Thumb"), ("Ankle", "Foot")
_TRUNK = (
    *("KneeLeft", "KneeRight", "Spine", "SpineMid", "ShoulderCenter"),
    *("SpineShoulder", "Neck", "Head"),
)
_GROUPS = {
    "arm L": (_ARM, ("arm R",)),
    "arm R": (_ARM, ()),
    "leg L": (_LEG, ("arm L", "arm R", "leg R")),
    "leg R": (_LEG, ("arm L", "arm R")),
    "trunk": (_TRUNK, ("arm L", "arm R")),
}
_SIDES = {"L": "Left", "R": "Right"}
_BITS = {group: bit for bit, group in enumerate(_GROUPS, start=1)}


def to_mujoco(values: Array) -> Array:
    """Turn vectors (..., 3) or quaternions wxyz (..., 4) into MuJoCo's z-up world."""
    return _permute(values, [2, 0, 1])  # (forward, left, up) of (x, y, z)


def from_mujoco(values: Array) -> Array:
    """Turn vectors (..., 3) or quaternions wxyz (..., 4) into kinefilter's world."""
    return _permute(values, [1, 2, 0])


def _permute(values: Array, order: list[int]) -> Array:
    if values.shape[-1] == 4:
        return np.asarray(values[..., [0, *(k + 1 for k in order)]])
    return np.asarray(values[..., order])


def build_humanoid(body: Body, tracking: Tracking | None = None) -> mujoco.MjSpec:
    """Return the capsule humanoid of a body standing in T-pose on a floor.

    Names: bodies, ball joints and sites are called after the joint a segment ends at;
    the site marks that joint. Actuators come in the skeleton's joint order, three
    forces (MuJoCo x, y, z) a joint, then three torques for the root and one for every
    segment. ``target:NAME`` are the mocap bodies whose orientation the torques follow.
    """
    tracking = tracking or Tracking()
    skeleton = body.skeleton
    spec = mujoco.MjSpec()
    spec.modelname = "kinefilter"
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    spec.option.timestep = 1.0 / 240.0
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    world = spec.worldbody
    world.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        friction=[1.0, 0.005, 0.0001],
        contype=1,
        conaffinity=1,
        solref=_HARD_FLOOR[0],
        solimp=_HARD_FLOOR[1],
    )
    world.add_site(name="world")
    _add_bodies(spec, body)
    _add_pulls(spec, body, tracking)
    # What lets a hand hold a thing: fingers, of which the capsule has none. Adhesion
    # presses it to whatever is within its reach while its control is 1.
    for hand in ("HandLeft", "HandRight"):
        spec.geom(hand).gap = _REACH
        spec.add_actuator(
            name=f"grip:{hand}",
            trntype=mujoco.mjtTrn.mjTRN_BODY,
            target=hand,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            gainprm=[_GRIP] + [0.0] * 9,
            ctrllimited=True,
            ctrlrange=[0.0, 1.0],
        )
    for joint in skeleton.joints:
        target = world.add_body(name=f"target:{joint}", mocap=True)
        target.add_site(name=f"target:{joint}")
    return spec


def _add_bodies(spec: mujoco.MjSpec, body: Body) -> None:
    skeleton, root = body.skeleton, body.skeleton.root
    offsets = to_mujoco(body.rest_offsets)
    rest_root = to_mujoco(body.rest_positions[root])
    swing = _swing_inertias(body)
    collides = {
        "condim": 3,
        "solref": _SOFT_FLESH[0],
        "solimp": _SOFT_FLESH[1],
        "solmix": 1e-3,  # against the floor or a prop, their hardness counts
    }
    parts: dict[int, mujoco.MjsBody] = {}
    for j in skeleton.order:
        name, p = skeleton.joints[j], skeleton.parents[j]
        shape: dict[str, Any]
        if j == root:
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
                damping=[_PASSIVE_DAMPING * swing[j], 0.0, 0.0],
            )
            shape = {"type": mujoco.mjtGeom.mjGEOM_CAPSULE}
            shape["fromto"] = [0.0, 0.0, 0.0, *offsets[j]]
        parts[j].add_geom(
            name=name,
            size=[body.radii[j], 0.0, 0.0],
            mass=body.masses[j],
            **shape,
            **_collisions(name),
            **collides,
        )
        parts[j].add_site(name=name, pos=offsets[j])
        if name.startswith("Foot"):
            # A capsule from ankle to toes touches the floor with the toes alone.
            height = float(body.rest_positions[p, 1] - body.radii[j])
            parts[j].add_geom(
                name=name.replace("Foot", "Heel"),
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                pos=[0.0, 0.0, -height],
                size=[body.radii[j], 0.0, 0.0],
                mass=0.0,
                **_collisions(""),
                **collides,
            )


def _collisions(name: str) -> dict[str, int]:
    """Return what the part that ends at a joint collides with, as MuJoCo's bits.

    Everything rests on the floor and on props. Hands and forearms meet each other, the
    trunk, the head and the legs; a lower leg meets the other. Parts that hang together
    at shoulders and hips overlap by nature.
    """
    for group, (parts, others) in _GROUPS.items():
        side = _SIDES.get(group[-1], "")
        if name in parts or (name.removesuffix(side) in parts and name.endswith(side)):
            bits = sum(1 << _BITS[other] for other in others)
            return {"contype": 1 << _BITS[group], "conaffinity": 1 | bits}
    return {"contype": 0, "conaffinity": 1}


def _add_pulls(spec: mujoco.MjSpec, body: Body, tracking: Tracking) -> None:
    """Add one Cartesian PD actuator per axis and joint (Shum 2013, eq. 16).

    force = kp (p_target - p) + kv (v_target - v), given ctrl = kp p_target +
    kv v_target, clipped so that the vector stays under the bound. And the torque about
    each segment's axis, all axes for the root (eq. 17).
    """
    skeleton = body.skeleton
    for joint, mass in zip(skeleton.joints, joint_masses(body), strict=True):
        for axis in range(3):
            _add_pd(
                spec,
                name=f"pull:{joint}:{'xyz'[axis]}",
                site=joint,
                reference="world",
                gear=np.eye(6)[axis],
                inertia=mass,
                frequency=tracking.natural_frequency,
                bound=mass * tracking.largest_acceleration / np.sqrt(3.0),
            )
    inertias = _TURNED_ALONG * _swing_inertias(body)
    # The pelvis carries the hips, which lie on a lever of their own length.
    hips = np.array(skeleton.children[skeleton.root])
    inertias[skeleton.root] += float(body.masses[hips] @ body.lengths[hips] ** 2) / 3.0
    axes = to_mujoco(body.rest_offsets)
    for j, joint in enumerate(skeleton.joints):
        at_root = j == skeleton.root
        turns = np.eye(3) if at_root else [axes[j] / np.linalg.norm(axes[j])]
        for k, direction in enumerate(turns):
            _add_pd(
                spec,
                name=f"turn:{joint}:{k}",
                site=joint,
                reference=f"target:{joint}",
                gear=np.concatenate([np.zeros(3), direction]),
                inertia=inertias[j],
                frequency=tracking.twist_frequency,
                bound=inertias[j] * tracking.largest_angular_acceleration,
            )


def _swing_inertias(body: Body) -> Array:
    """Return the inertia of each segment about its start [kg m^2], shape (J,)."""
    return np.asarray(body.masses * body.lengths**2 / 3.0 + _ARMATURE)


def _add_pd(
    spec: mujoco.MjSpec,
    *,
    name: str,
    site: str,
    reference: str,
    gear: Array,
    inertia: float,
    frequency: float,
    bound: float,
) -> None:
    """Add a critically damped PD actuator with a bound of its force or torque."""
    stiffness, damping = inertia * frequency**2, 2.0 * inertia * frequency
    spec.add_actuator(
        name=name,
        trntype=mujoco.mjtTrn.mjTRN_SITE,
        target=site,
        refsite=reference,
        gear=gear,
        group=PULLS,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        gainprm=[1.0] + [0.0] * 9,
        biasprm=[0.0, -stiffness, -damping] + [0.0] * 7,
        forcelimited=True,
        forcerange=[-bound, bound],
    )
