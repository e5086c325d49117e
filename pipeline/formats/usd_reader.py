"""Reading USD: whole clips of kinefilter, joint positions and contents of any file.

Files from outside are read in a separate process (``guarded``), which calls the
functions here that return arrays by name.
"""

import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdSkel, Vt

from kinefilter.characters import Clip, InputError, Prop, Shape, Skeleton, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import normalize, wxyz_from_matrix

from .export import DAMAGED, GAMMA, PER_CLIP, PER_FRAME, from_z_up, name_tables
from .files import refused
from .npz import clip_as_arrays
from .rig import motion_of_rig, own_skeleton, rig_of
from .usd_character import CHARACTER, SKELETON

_MOST_JOINTS = 1000  # as in BVH
_KINDS = {"Cube": "box", "Sphere": "ellipsoid"}  # the other shapes have the same name


def contents_arrays(path: str) -> dict[str, NDArray[Any]]:
    """Return units, up axis, rate, joints and duration of an animation, as JSON."""
    with refused(path, DAMAGED):
        stage, _, query, names, codes = first_animated(path)
        if any(query.ComputeJointSkelTransforms(code) is None for code in codes):
            raise InputError(DAMAGED)
        time = np.array(codes) / stage.GetTimeCodesPerSecond()
        prims = stage.Traverse()
        authored = {a.GetName() for prim in prims for a in prim.GetAuthoredAttributes()}
        meters = float(UsdGeom.GetStageMetersPerUnit(stage))
        character = stage.GetPrimAtPath(CHARACTER)
        root = character and character.GetAttribute("kinefilter:root")
        moves = {"in_place": root.Get() != "travel"} if root else {}
    steps = np.diff(time)
    contents = {
        "unit": f"{meters:g} m",
        "up_axis": str(UsdGeom.GetStageUpAxis(stage)),
        "joints": len(names),
        "names": list(names),
        "frames": len(time),
        "seconds": float(time[-1] - time[0]) if len(time) else 0.0,
        "fps": float(1.0 / np.median(steps)) if len(steps) and steps.all() else None,
        "time_codes_per_second": float(stage.GetTimeCodesPerSecond()),
        **moves,
        "attributes": sorted(name for name in authored if "kinefilter:" in name),
    }
    return {"json": np.array(json.dumps(contents))}


def clip_arrays(path: str) -> dict[str, NDArray[Any]]:
    """Return a clip that kinefilter wrote on its own skeleton, as npz stores it.

    Axes and unit are converted back, and time starts at 0. The sensor's states are
    unknown, so all joints count as tracked; stature and mass come from the segments.
    """
    with refused(path, DAMAGED):
        stage, _, query, names, codes = first_animated(path)
        skeleton = own_skeleton(names)
        if skeleton is None:
            first = ", ".join(names[:3])[:60]
            wrong = f"its skeleton ({first}, ...) is not one of kinefilter's own"
            raise InputError(f"{path}: {wrong}; write it without --rig")
        character = stage.GetPrimAtPath(CHARACTER)
        rated = character.GetAttribute("kinefilter:reliability")
        if rated and (frames := set(rated.GetTimeSamples())):
            # A sample that only ends a long gap is not a frame of the clip.
            codes = [code for code in codes if code in frames]
        meters = UsdGeom.GetStageMetersPerUnit(stage)
        z_up = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
        axes = from_z_up if z_up else np.asarray
        animation = UsdSkel.Animation(query.GetAnimQuery().GetPrim())
        places = _samples(animation.GetTranslationsAttr(), codes)
        xyzw = _samples(animation.GetRotationsAttr(), codes)
        folder, props = stage.GetPrimAtPath(f"{CHARACTER}/Props"), []
        for prim in folder.GetChildren() if folder else ():
            shapes = tuple(_shape(part, axes, meters) for part in prim.GetChildren())
            where, turns = _placed(prim, codes)
            where = axes(where) * meters
            props.append(Prop(prim.GetName(), shapes, where, axes(turns)))
        turns = axes(normalize(np.roll(xyzw, 1, axis=-1).astype(np.float64)))
        world = rig_of(standard_body(skeleton)).world_rotations(turns)
        root = axes(places[:, 0].astype(np.float64)) * meters
        time = np.array(codes) / stage.GetTimeCodesPerSecond()
        offsets = axes(places[0].astype(np.float64)) * meters  # not those of a layer
        motion = motion_of_rig(skeleton, offsets, world, root, time, path)
        provenance = _provenance(character, codes, skeleton, path)
        return clip_as_arrays(Clip.of(motion, **provenance, props=tuple(props)))


def character_arrays(path: str) -> dict[str, NDArray[Any]]:
    """Return a character layer's joints and their places in its axes and unit.

    Also its up axis and unit [m]. Raises an InputError if it cannot be read.
    """
    expected = "a layer from 'kinefilter clean --character', or an unused name"
    with refused(path, f"cannot be read as USD; give --character {expected}"):
        stage = Usd.Stage.Open(path)
        skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath(SKELETON))
        joints = skeleton.GetJointsAttr().Get() if skeleton else None
        bind = skeleton.GetBindTransformsAttr().Get() if skeleton else None
        return {
            "joints": np.array([str(joint) for joint in joints or ()]),
            "places": np.reshape([np.array(m)[3, :3] for m in bind or ()], (-1, 3)),
            "up": np.array(UsdGeom.GetStageUpAxis(stage).lower()),
            "unit": np.array(UsdGeom.GetStageMetersPerUnit(stage)),
        }


def rest_arrays(path: str) -> dict[str, NDArray[Any]]:
    """Return the first skeleton at rest, y up, in meters, or raise InputError."""
    with refused(path, "not USD; expected a UsdSkel skeleton"):
        stage = Usd.Stage.Open(path)
        prims = [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Skeleton)]
        if not prims:
            raise InputError(f"{path}: has no skeleton; expected a UsdSkel skeleton")
        place = UsdGeom.Imageable(prims[0]).ComputeLocalToWorldTransform
        world = np.array(place(Usd.TimeCode.EarliestTime()))
        names, parents, matrices = _joints(UsdSkel.Skeleton(prims[0]), path)
    rows = (matrices @ world)[:, :, :3]  # the joint's axes, then its place
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z:
        rows = from_z_up(rows)
    places = rows[:, 3] * UsdGeom.GetStageMetersPerUnit(stage)
    turned = np.swapaxes(rows[:, :3], 1, 2)
    sizes = np.linalg.norm(turned, axis=1, keepdims=True)
    if not (np.linalg.det(turned) > 0.0).all() or not np.isfinite(places).all():
        raise InputError(f"{path}: a joint is mirrored or has no size; apply its scale")
    axes = wxyz_from_matrix(turned / sizes)
    arrays = {"names": names, "parents": parents, "places": places, "axes": axes}
    return {key: np.array(value) for key, value in arrays.items()}


def _joints(skeleton: Any, source: str) -> tuple[list[str], list[int], Array]:
    """Return names, parents and matrices in the skeleton's space (N, 4, 4)."""
    joints = skeleton.GetJointsAttr().Get()
    paths = [str(p) for p in joints] if isinstance(joints, Vt.TokenArray) else []
    if not 0 < len(paths) <= _MOST_JOINTS:
        raise InputError(f"{source}: {len(paths)} joints, expected 1 to {_MOST_JOINTS}")
    topology = UsdSkel.Topology(paths)
    valid, why = topology.Validate()
    if not valid:
        raise InputError(f"{source}: its joints are not a tree ({why}); correct them")
    parents = [int(parent) for parent in topology.GetParentIndices()]
    found = skeleton.GetRestTransformsAttr().Get()
    if isinstance(found, Vt.Matrix4dArray) and len(found) == len(paths):
        found = UsdSkel.ConcatJointTransforms(topology, found)
    else:
        found = skeleton.GetBindTransformsAttr().Get()
    matrices = np.array(found if isinstance(found, Vt.Matrix4dArray) else ())
    if matrices.shape != (len(paths), 4, 4) or not np.isfinite(matrices).all():
        raise InputError(
            f"{source}: has no rest transform for each of its {len(paths)} joints; "
            "export it with a rest or bind pose"
        )
    return [path.rpartition("/")[2] for path in paths], parents, matrices


def first_animated(path: str) -> tuple[Any, Any, Any, list[str], list[float]]:
    """Return stage, prim, query, joint names and time codes of a skeleton."""
    cache = UsdSkel.Cache()
    with refused(path, "cannot be read as USD; expected .usda, .usdc or .usd"):
        stage = Usd.Stage.Open(path)
    at_rest = False
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Root):
            cache.Populate(UsdSkel.Root(prim), Usd.PrimDefaultPredicate)
        if prim.IsA(UsdSkel.Skeleton):
            at_rest = True
            query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
            if query and query.GetAnimQuery():
                names = [str(path).rpartition("/")[2] for path in query.GetJointOrder()]
                codes = list(query.GetAnimQuery().GetJointTransformTimeSamples())
                return stage, prim, query, names, codes
    hint = (
        "give a clip that refers to it" if at_rest else "expected a UsdSkel animation"
    )
    only = ", only one at rest, as a file of --character has" if at_rest else ""
    raise InputError(f"{path}: has no animated skeleton{only}; {hint}")


def _samples(attribute: Any, codes: Sequence[float]) -> NDArray[Any]:
    return np.array([np.array(attribute.Get(code)) for code in codes])


def _provenance(
    character: Any, codes: Sequence[float], skeleton: Skeleton, path: str
) -> dict[str, Any]:
    def attribute(name: str) -> Any:
        return character.GetAttribute(f"kinefilter:{name}")

    for name, expected in name_tables(skeleton).items():
        found = attribute(name).Get()
        if found is not None and list(found) != expected:
            raise InputError(
                f"{path}: kinefilter:{name} are {', '.join(found)[:60]}, expected "
                f"{', '.join(expected)[:60]}; write the clip again"
            )
    arrays: dict[str, Any] = {}
    for name, field in PER_FRAME.items():
        if attribute(name) and attribute(name).GetTimeSamples():
            values = _samples(attribute(name), codes)
            if values.dtype.kind == "f":
                values[values < 0.0] = np.nan
            arrays[field] = values
    force = attribute("externalForce")
    simulated = set(force.GetTimeSamples()) if force else set()
    forces = [force.Get(code) if code in simulated else np.nan for code in codes]
    arrays["external_force"] = np.array(forces)
    for name, field in PER_CLIP.items():
        number = attribute(name).Get()
        missing = 0.0 if field == "roll" else np.nan
        arrays[field] = missing if number is None else float(number)
    return arrays


def _placed(prim: Any, codes: Sequence[float]) -> tuple[Array, Array]:
    """Return a prim's positions (T, 3) and rotations wxyz (T, 4); T is 1 at rest."""
    translate = prim.GetAttribute("xformOp:translate")
    orient = prim.GetAttribute("xformOp:orient")
    times = codes if translate.GetTimeSamples() else codes[:1]
    turns = [orient.Get(code) for code in times]
    wxyz = np.array([[turn.GetReal(), *turn.GetImaginary()] for turn in turns])
    return np.array([translate.Get(code) for code in times], dtype=float), wxyz


def _shape(prim: Any, axes: Callable[[Array], Array], meters: float) -> Shape:
    def number(name: str) -> Any:
        return np.array(prim.GetAttribute(name).Get(), dtype=float)

    kind = str(prim.GetTypeName())
    (place,), (turn,) = _placed(prim, [0.0])
    points, triangles = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    if kind == "Mesh":
        points = axes(number("points")) * meters
        triangles = number("faceVertexIndices").astype(np.int64).reshape(-1, 3)
        size = np.abs(points).max(axis=0)
    elif kind in ("Capsule", "Cylinder"):
        radius, height = number("radius"), number("height")
        size = np.array([radius, 0.5 * height, radius]) * meters
    else:
        size = np.abs(axes(number("xformOp:scale"))) * meters
    kind_name: Any = _KINDS.get(kind, kind.lower())
    color, place = number("primvars:displayColor")[0] ** (1.0 / GAMMA), axes(place)
    return Shape(kind_name, size, place * meters, axes(turn), color, points, triangles)
