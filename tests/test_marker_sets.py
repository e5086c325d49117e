"""Joint centers from markers, by tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from text_files import write_text

from kinefilter.characters import KINECT_V1, InputError
from kinefilter.pipeline.lab.marker_sets import PLUG_IN_GAIT, read_marker_set

FAR = [1, 2, 3]
joint = KINECT_V1.index


def test_plug_in_gait_markers_become_joint_centers() -> None:
    """A body that stands facing +z, and turned in any way."""
    places = """LASI .13 1 .1 LPSI .05 1 -.1 LKNE .15 .5 .043 LANK .14 .1 0 LTOE .1 0 .1
        LSHO .18 1.45 0 LELB .25 1.15 0 LWRA .27 .9 .05 LWRB .27 .9 -.03
        LFHD .07 1.7 .1 LBHD .07 1.7 -.1"""
    rows = np.array(places.split()).reshape(-1, 4)
    markers = {str(name): np.array(place, float) for name, *place in rows.tolist()}
    markers |= {f"R{n[1:]}": p * [-1, 1, 1] for n, p in markers.items()}
    middle = {"C7": (1.5, -0.1), "CLAV": (1.4, 0.1), "T10": (1.2, -0.1)}
    middle["STRN"] = (1.1, 0.1)
    markers |= {name: np.array([0.0, y, z]) for name, (y, z) in middle.items()}
    turns = Rotation.random(7, rng=np.random.default_rng(3))
    turned = {n: turns.apply(p) + FAR for n, p in markers.items()}
    found = read_marker_set().centers(turned, KINECT_V1) - FAR
    upright = {
        "HipLeft": (0.36 * 0.26, 1.0 - 0.30 * 0.26, 0.1 - 0.22 * 0.26),
        "KneeLeft": None,
        "ShoulderRight": (-0.18, 1.4, 0.0),
        "WristLeft": (0.27, 0.9, 0.01),
        "ElbowRight": (-0.25, 1.15, 0.0),
        "HipCenter": (0.0, 1.0 - 0.30 * 0.26, 0.1 - 0.22 * 0.26),
        "Head": (0.0, 1.7, 0.0),
    }
    for name, place in upright.items():
        if place is not None:
            there = turns.inv().apply(found[:, joint(name)])
            np.testing.assert_allclose(there, np.tile(place, (7, 1)), atol=1e-9)
    knee, ankle, hip = (
        turns.inv().apply(found[:, joint(f"{name}Left")])
        for name in ("Knee", "Ankle", "Hip")
    )
    inward = markers["LKNE"] - knee
    np.testing.assert_allclose(np.linalg.norm(inward, axis=1), 0.055)
    np.testing.assert_allclose(
        np.sum(inward * (hip - markers["LKNE"]), axis=1), 0.0, atol=1e-9
    )
    assert (inward[:, 0] > 0.05).all()
    np.testing.assert_allclose(markers["LANK"] - ankle, inward * 0.042 / 0.055)
    assert np.isnan(found[:, joint("HandLeft")]).all()


TABLE = PLUG_IN_GAIT.read_text("utf-8")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[limbs]", "[arms]", ["expected tables"]),
        ("[limbs]", "[limbs", ["not TOML"]),
        ('left = [["RASI"], ["LASI"]]', "", ["'pelvis'", "two of left, up"]),
        ('[["RASI"], ["LASI"]]', '[["RASI"]]', ["'pelvis'", "from and to"]),
        ('[["RASI"], ["LASI"]]', "[[1], [2]]", ["'pelvis'", "names"]),
        ('at = ["LKNE"]', "at = []", ["'KneeLeft'", "list of names"]),
        ('at = ["LKNE"], ', "", ["'KneeLeft'", "expected at"]),
        ('"thigh_left"', '"shank"', ["'KneeLeft'", "'shank'", "pelvis"]),
        ('"thigh_left"', "[1]", ["'KneeLeft'", "unknown frame"]),
        ("-0.055", "-55.0", ["'KneeLeft'", "under 2"]),
        ("[-0.055, 0.0, 0.0]", "[-0.055]", ["'KneeLeft'", "three numbers"]),
        ("-0.055", "nan", ["'KneeLeft'", "three numbers"]),
        ("KneeLeft =", "KneeMiddle =", ["'KneeMiddle'", "no such joint"]),
        ('times = ["LASI", "RASI"]', 'times = ["LASI"]', ["two names"]),
        (', frame = "thigh_left"', "", ["'KneeLeft'", "needs a frame"]),
    ],
)
def test_damaged_tables_are_refused_naming_the_place(
    tmp_path: Path, old: str, new: str, words: list[str]
) -> None:
    assert old in TABLE
    path = write_text(tmp_path / "own.toml", TABLE.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_marker_set(path)
    for word in (str(path), *words):
        assert word in str(caught.value)
