"""The skeletons of other people's rigs: built from a map, or read from their files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from kinefilter.characters import Body, InputError
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import wxyz_from_matrix
from kinefilter.retarget.rig_map import RigMap, load_rig_map
from kinefilter.retarget.target_rig import RestPose, TargetRig, built_rig, matched_rig

from .bvh import meters_by_leg, read_bvh
from .export import USD_SUFFIXES, with_y_up
from .usd_reader import check_usd

_MOST_JOINTS = 1000  # as in BVH


def target_rig(rig: str, target: Path | None, body: Body) -> TargetRig:
    """Return the skeleton that a clip is written on.

    ``rig`` is the name of a map, or its file; ``target`` a file with the skeleton at
    rest, None for the map's own in the person's size. Raises InputError if either
    cannot be read, or the file's joints do not have the map's names.
    """
    rig_map = load_rig_map(rig)
    if target is None:
        return built_rig(rig_map, body)
    suffix = target.suffix.lower()
    if suffix == ".bvh":
        return matched_rig(rig_map, _bvh_rest(target, rig_map), body)
    if suffix in USD_SUFFIXES:
        return matched_rig(rig_map, _usd_rest(target), body)
    raise InputError(f"--target {target}: expected .bvh, {', '.join(USD_SUFFIXES)}")


def _bvh_rest(path: Path, rig_map: RigMap) -> RestPose:
    """Return a BVH file's skeleton, in the unit in which it has a person's legs."""
    bvh = read_bvh(path)
    joints, meters = bvh.joints, 1.0
    index = {n: k for k, n in enumerate(joints)}
    names = tuple(bvh.names[n] for n in joints)
    plain = [rig_map.plain(name) for name in names]
    chain = [rig_map.plain(rig_map.of(f"left {p}")[0].name) for p in ("thigh", "foot")]
    places = bvh.rest_positions[joints]
    if set(chain) <= set(plain):
        thigh, foot = (places[plain.index(name)] for name in chain)
        meters = meters_by_leg(float(np.linalg.norm(foot - thigh)))
    parents = tuple(index.get(bvh.parents[n], -1) for n in joints)
    lowest = meters * float(bvh.rest_positions[:, 1].min())
    return RestPose(names, parents, meters * places, lowest=lowest, source=str(path))


def _usd_rest(path: Path) -> RestPose:
    """Return the first skeleton of a USD file at rest, y up, in meters."""
    from pxr import Tf, Usd, UsdGeom, UsdSkel

    source = str(path)
    check_usd(source)
    try:
        stage = Usd.Stage.Open(source)
        prims = [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Skeleton)]
        if not prims:
            raise InputError(f"{path}: has no skeleton; expected a UsdSkel skeleton")
        place = UsdGeom.Imageable(prims[0]).ComputeLocalToWorldTransform
        world = np.array(place(Usd.TimeCode.EarliestTime()))
        names, parents, matrices = _joints(UsdSkel.Skeleton(prims[0]), source)
    except Tf.ErrorException:
        raise InputError(
            f"{path}: cannot be read as USD; expected a UsdSkel skeleton"
        ) from None
    matrices = matrices @ world
    places = matrices[:, 3, :3] * UsdGeom.GetStageMetersPerUnit(stage)
    turned = np.swapaxes(matrices[:, :3, :3], 1, 2)
    sizes = np.linalg.norm(turned, axis=1, keepdims=True)
    if not (np.linalg.det(turned) > 0.0).all() or not np.isfinite(places).all():
        raise InputError(
            f"{source}: a joint is mirrored or has no size at rest; apply its scale"
        )
    axes = wxyz_from_matrix(turned / sizes)
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z:
        places, axes = with_y_up(places), with_y_up(axes)
    return RestPose(tuple(names), tuple(parents), places, axes, source=source)


def _joints(skeleton: Any, source: str) -> tuple[list[str], list[int], Array]:
    """Return names, parents and matrices in the skeleton's space (N, 4, 4)."""
    from pxr import UsdSkel, Vt

    def read(attribute: Any) -> Array:
        value = attribute.Get()
        known = isinstance(value, Vt.Matrix4dArray)
        return np.array(value, dtype=float) if known else np.empty((0, 4, 4))

    joints = skeleton.GetJointsAttr().Get()
    paths = [str(p) for p in joints] if isinstance(joints, Vt.TokenArray) else []
    if not 0 < len(paths) <= _MOST_JOINTS:
        raise InputError(f"{source}: {len(paths)} joints, expected 1 to {_MOST_JOINTS}")
    topology = UsdSkel.Topology(paths)
    valid, why = topology.Validate()
    if not valid:
        raise InputError(f"{source}: its joints are not a tree ({why}); correct them")
    parents = [int(parent) for parent in topology.GetParentIndices()]
    local = read(skeleton.GetRestTransformsAttr())
    matrices = read(skeleton.GetBindTransformsAttr())
    if len(local) == len(paths):
        matrices = local.copy()
        for n, parent in enumerate(parents):
            if parent >= 0:
                matrices[n] = local[n] @ matrices[parent]
    if matrices.shape != (len(paths), 4, 4) or not np.isfinite(matrices).all():
        raise InputError(
            f"{source}: has no rest transform for each of its {len(paths)} joints; "
            "export it with rest or bind pose"
        )
    return [path.rpartition("/")[2] for path in paths], parents, matrices
