"""Mocap in ASF and AMC, C3D and BVH of several rigs, as sources of Kinect joints."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from skeletons import every_skeleton
from text_files import write_text

from kinefilter.characters import KINECT_V1, InputError, Skeleton, standard_body
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.formats.acclaim import read_amc, read_asf
from kinefilter.pipeline.formats.markers import read_c3d
from kinefilter.pipeline.formats.mocap import RIGS, kinect_motion, read_mocap
from kinefilter.pipeline.formats.recording import Mocap
from kinefilter.pipeline.lab.database_build import database_from_mocap
from kinefilter.retarget.rig_map import load_source_rig, matching_source_rig

Array = NDArray[np.float64]
# ASF and AMC
ARM = """# comment
:version 1.10
:name ARM
:units
  mass 1.0
  length 0.45
  angle deg
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name upper
     direction 0 1 0
     length 2
     axis 0 0 90 XYZ
     dof rx ry rz
     limits (-160.0 20.0)
            (-70.0 70.0)
            (-60.0 70.0)
  end
  begin
     id 2
     name lower
     direction 0 0 1
     length 3
     axis 10 20 30 XYZ
     dof ry
  end
  begin
     id 3
     name tip
     direction 1 0 0
     length 0.5
     axis 0 0 0 XYZ
  end
:hierarchy
  begin
    root upper
    upper lower
    lower tip
  end
"""
ARM_MOTION = """#!OML:ASF
:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 0 90 0
upper 10 20 30
lower 40
2
root 0 0 0 0 0 0
upper 0 0 0
lower 0
"""


def turn(axes: str, *degrees: float) -> Array:
    """Return the matrix of turns about fixed axes, by SciPy."""
    return Rotation.from_euler(axes, degrees, degrees=True).as_matrix().reshape(3, 3)


def test_amc_bones_end_where_matrices_put_them(tmp_path: Path) -> None:
    skeleton = read_asf(write_text(tmp_path / "arm.asf", ARM))
    mocap = read_amc(write_text(tmp_path / "arm.amc", ARM_MOTION), skeleton)
    assert mocap.names == ("root", "upper", "lower", "tip")
    root = turn("xyz", 0, 90, 0)
    own = turn("xyz", 0, 0, 90)
    upper = root @ own @ turn("xyz", 10, 20, 30) @ own.T
    own = turn("xyz", 10, 20, 30)
    lower = upper @ own @ turn("y", 40) @ own.T
    places = [np.array([1.0, 2.0, 3.0])]
    places.append(places[-1] + upper @ [0, 2, 0])
    places.append(places[-1] + lower @ [0, 0, 3])
    places.append(places[-1] + lower @ [0.5, 0, 0])
    np.testing.assert_allclose(mocap.positions[0], places, atol=1e-12)
    still = [[0, 0, 0], [0, 2, 0], [0, 2, 3], [0.5, 2, 3]]
    np.testing.assert_allclose(mocap.positions[1], still, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("length 2", "length two", ["line 18", "1 finite number"]),
        ("direction 0 1 0", "direction 0 1 nan", ["line 17", "finite"]),
        ("axis 0 0 90 XYZ", "axis 0 0 90 XXZ", ["axis"]),
        ("dof ry\n", "dof rq\n", ["degrees of freedom 'rq'"]),
        ("lower tip", "lower tip lower", ["second parent"]),
        ("lower tip", "lower top", ["'top'", "not a bone"]),
        ("name lower", "name upper", ["'upper' again"]),
        ("orientation 0 0 0", "orientation 0 5 0", ["turns the root"]),
    ],
)
def test_damaged_asf_files_are_refused_naming_the_line(
    tmp_path: Path, old: str, new: str, words: list[str]
) -> None:
    assert old in ARM
    path = write_text(tmp_path / "arm.asf", ARM.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_asf(path)
    for word in (str(path), *words):
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["not mocap"]),
        (":DEGREES\n", ["no frames"]),
        (ARM_MOTION.replace("lower 40\n", ""), ["ends frame 1", "'lower'"]),
        (ARM_MOTION[:-8], ["ends frame 2", "'lower'"]),
        (ARM_MOTION.replace("upper 10 20 30", "upper 10 20"), ["line 6", "3 finite"]),
        (ARM_MOTION.replace("upper 10", "upper nan"), ["line 6", "3 finite"]),
        (ARM_MOTION.replace("upper 10", "wing 10"), ["line 6", "'wing'", "ASF"]),
        (ARM_MOTION.replace("lower 40", "upper 1 2 3"), ["line 7", "twice"]),
    ],
)
def test_damaged_amc_files_are_refused_naming_the_line(
    tmp_path: Path, text: str, words: list[str]
) -> None:
    write_text(tmp_path / "arm.asf", ARM)
    path = write_text(tmp_path / "arm.amc", text)
    with pytest.raises(InputError) as caught:
        read_mocap(path)
    for word in (str(path), *words):
        assert word in str(caught.value)


# Where a rig's joints come from


def standing(skeleton: Skeleton, rig: str) -> Mocap:
    """Return a T-pose under a rig's names [cm], z up, whose left arm moves forward."""
    body, source = standard_body(skeleton), load_source_rig(rig, skeleton)
    rest = np.tile([0.3, 1.0, 0.2], (len(skeleton), 1))
    for j in skeleton.order[1:]:
        rest[j] = rest[skeleton.parents[j]] + body.rest_offsets[j]
    places = dict.fromkeys(source.needed, rest[skeleton.root])
    # What is the mean of two joints comes first: the two know better where they are.
    for joint, row in sorted(source.joints.items(), key=lambda item: -len(item[1].at)):
        places |= dict.fromkeys(row.at, rest[skeleton.index(joint)])
    positions = np.tile(np.array(list(places.values())), (30, 1, 1))
    for name in source.joints["WristLeft"].at:
        positions[:, list(places).index(name), 2] += np.linspace(0.0, 0.3, 30)
    x, y, z = np.moveaxis(positions, -1, 0)
    zup = 100.0 * np.stack([x, -z, y], axis=-1)
    return Mocap(tuple(places), zup, None, 1 / 30, rig)


@every_skeleton
@pytest.mark.parametrize("rig", [*RIGS, "jointed", "rokoko", "ipi"])
def test_every_rig_stands_upright_in_meters(skeleton: Skeleton, rig: str) -> None:
    motion = kinect_motion(standing(skeleton, rig), skeleton, (rig,))
    assert (motion.rig, motion.unit) == (rig, "cm")
    places = motion.positions[0] * motion.meters
    body = standard_body(skeleton)
    head, foot = (skeleton.index(name) for name in ("Head", "AnkleLeft"))
    height = places[head, 1] - places[foot, 1]
    assert 0.75 * body.height < height < body.height
    left, right = (skeleton.index(f"Shoulder{side}") for side in ("Left", "Right"))
    assert places[left, 0] - places[right, 0] == pytest.approx(
        2.0 * body.lengths[left], rel=1e-6
    )


@every_skeleton
@pytest.mark.parametrize("rig", [*RIGS, "jointed", "rokoko", "ipi"])
def test_rigs_name_joints_that_the_skeleton_has(skeleton: Skeleton, rig: str) -> None:
    source = load_source_rig(rig, skeleton)
    names = source.needed.union(*(joint.at for joint in source.joints.values()))
    found, missing = matching_source_rig(names, skeleton, (rig,))
    assert missing == []
    assert set(found.joints) <= set(skeleton.joints)
    limbs = {"Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle"}
    sides = {f"{limb}{side}" for limb in limbs for side in ("Left", "Right")}
    assert sides | {"Head"} <= set(found.joints)


# C3D


def write_c3d(path: Path, mocap: Mocap, prefix: str = "") -> Path:
    import ezc3d

    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [1.0 / mocap.frame_time]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    labels = tuple(prefix + name for name in mocap.names)
    file["parameters"]["POINT"]["LABELS"]["value"] = labels
    points = np.ones((4, len(mocap.names), len(mocap.positions)))
    points[:3] = np.moveaxis(10.0 * mocap.positions, -1, 0).swapaxes(1, 2)
    file["data"]["points"] = points
    file.write(str(path))
    return path


def write_trc(path: Path, mocap: Mocap) -> Path:
    """Write positions [cm] as OpenSim does, with empty cells for what is missing."""
    names = [f"{name}\t\t" for name in mocap.names]
    rate, count = 1.0 / mocap.frame_time, len(mocap.positions)
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
        f"{rate:g}\t{rate:g}\t{count}\t{len(names)}\tmm",
        "Frame#\tTime\t" + "\t".join(names),
        "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, len(names) + 1)),
        "",
    ]
    for k, frame in enumerate(10.0 * mocap.positions):
        cells = ["" if np.isnan(value) else f"{value:.6f}" for value in frame.ravel()]
        lines.append("\t".join([str(k + 1), f"{k * mocap.frame_time:.6f}", *cells]))
    return write_text(path, "\r\n".join(lines) + "\r\n")


@every_skeleton
@pytest.mark.parametrize("prefix", ["", "Jane:"])
def test_c3d_joint_centers_become_a_database(
    tmp_path: Path, skeleton: Skeleton, prefix: str
) -> None:
    path = write_c3d(tmp_path / "a.c3d", standing(skeleton, "plug_in_gait"), prefix)
    mocap = read_mocap(path)
    assert mocap.names[0].startswith(prefix)
    assert mocap.frame_time == pytest.approx(1 / 30)
    base = database_from_mocap([path], skeleton)
    assert len(base) >= 10
    assert np.isfinite(base.positions).all()


def test_c3d_points_that_no_camera_saw_are_missing(tmp_path: Path) -> None:
    mocap = standing(KINECT_V1, "plug_in_gait")
    mocap.positions[3, 2] = np.nan
    again = read_c3d(write_c3d(tmp_path / "a.c3d", mocap))
    assert np.isnan(again.positions[3, 2]).all()
    assert np.isfinite(again.positions[4]).all()


def test_c3d_of_bare_markers_is_refused_naming_those_found(tmp_path: Path) -> None:
    mocap = standing(KINECT_V1, "plug_in_gait")
    markers = tuple(f"M{k}" for k in range(len(mocap.names)))
    bare = Mocap(markers, mocap.positions, None, 1 / 30, "x")
    path = write_c3d(tmp_path / "a.c3d", bare)
    with pytest.raises(InputError, match=r"a\.c3d: no joint.*found M0, M1"):
        database_from_mocap([path], KINECT_V1)


@pytest.mark.parametrize(
    ("at", "value"), [(2, 65535), (8, 65535), (4, 65535), (16, 60000), (2, 0)]
)
def test_c3d_headers_that_promise_too_much_are_refused(
    tmp_path: Path, at: int, value: int
) -> None:
    path = write_c3d(tmp_path / "a.c3d", standing(KINECT_V1, "plug_in_gait"))
    data = bytearray(path.read_bytes())
    data[at : at + 2] = struct.pack("<H", value)
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"a\.c3d.*do not fit"):
        read_c3d(path)


def test_a_c3d_file_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    path = write_c3d(tmp_path / "a.c3d", standing(KINECT_V1, "plug_in_gait"))
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(InputError, match=r"a\.c3d"):
        read_c3d(path)


# Databases


def acclaim_files(folder: Path) -> list[Path]:
    """Write a T-pose body in CMU's bones whose left knee bends."""
    body = standard_body(KINECT_V1)
    bones = {"lowerback": "root", "upperback": "lowerback", "thorax": "upperback"}
    bones |= {"lowerneck": "thorax", "upperneck": "lowerneck"}
    chain = ("clavicle", "humerus", "radius", "hand")
    legs = ("hipjoint", "femur", "tibia", "foot")
    for side in "lr":
        for above, limb in (("thorax", chain), ("root", legs)):
            parents = [above, *(side + bone for bone in limb)]
            bones |= {side + bone: parents[k] for k, bone in enumerate(limb)}
    ends = {
        **dict.fromkeys(("clavicle",), "Shoulder"),
        "humerus": "Elbow",
        "radius": "Wrist",
        "hand": "Hand",
        "hipjoint": "Hip",
        "femur": "Knee",
        "tibia": "Ankle",
        "foot": "Foot",
    }
    lines = [":units", "angle deg", ":root", "order TX TY TZ RX RY RZ", ":bonedata"]
    for name in bones:
        joint = ends.get(name[1:])
        side = "Left" if name[0] == "l" else "Right"
        offset = np.array([0.0, 0.12, 0.0])
        if joint:
            offset = body.rest_offsets[KINECT_V1.index(joint + side)]
        length = float(np.linalg.norm(offset))
        x, y, z = offset / length
        lines += ["begin", f"name {name}", f"direction {x} {y} {z}"]
        lines += [f"length {length}", "axis 0 0 0 XYZ"]
        lines += ["dof rx"] * (name == "ltibia") + ["end"]
    lines += [":hierarchy", "begin"]
    lines += [f"{parent} {name}" for name, parent in bones.items()] + ["end"]
    asf = write_text(folder / "07.asf", "\n".join(lines) + "\n")
    motion = [":FULLY-SPECIFIED", ":DEGREES"]
    for k in range(120):
        motion += [f"{k + 1}", f"root 0 {k / 100} 0 0 0 0", f"ltibia {k / 2}"]
    return [asf, write_text(folder / "07_01.amc", "\n".join(motion) + "\n")]


@every_skeleton
def test_asf_and_amc_become_a_database_whose_knee_bends(
    tmp_path: Path, skeleton: Skeleton
) -> None:
    base = database_from_mocap(acclaim_files(tmp_path), skeleton)
    assert 25 <= len(base) <= 30
    hip, knee, ankle = (skeleton.index(f"{p}Left") for p in ("Hip", "Knee", "Ankle"))
    thigh = base.positions[:, knee] - base.positions[:, hip]
    shin = base.positions[:, ankle] - base.positions[:, knee]
    cosine = np.sum(thigh * shin, axis=1)
    cosine /= np.linalg.norm(thigh, axis=1) * np.linalg.norm(shin, axis=1)
    bent = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    np.testing.assert_allclose(bent.max(), 58.0, atol=1.0)


def test_database_build_takes_asf_and_amc(tmp_path: Path) -> None:
    files = [str(path) for path in acclaim_files(tmp_path)]
    out = tmp_path / "base.npz"
    assert main(["database", "build", *files, "-o", str(out)]) == 0
    assert set(PostureDatabase.load(out).labels.tolist()) == {"07_01"}


def test_info_tells_of_an_amc_file_zipped_or_not(tmp_path: Path) -> None:
    _, amc = acclaim_files(tmp_path)
    zipped = amc.with_name(amc.name + ".gz")
    zipped.write_bytes(gzip.compress(amc.read_bytes()))
    one, other = contents_of(amc), contents_of(zipped)
    assert one["kind"] == "mocap"
    assert one | {"file": ""} == other | {"file": ""}


def test_an_amc_file_without_its_skeleton_is_refused(tmp_path: Path) -> None:
    asf, amc = acclaim_files(tmp_path)
    asf.unlink()
    with pytest.raises(InputError, match=r"07_01\.amc: no ASF file"):
        database_from_mocap([amc], KINECT_V1)
    with pytest.raises(InputError, match="no BVH, AMC, C3D or TRC"):
        database_from_mocap([asf], KINECT_V1)
