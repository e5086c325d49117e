"""Bone lengths, amplitude and distances moved where known, and all together."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
from known_motions import BODY, stamps, standing
from skeletons import every_skeleton

from kinefilter.characters import (
    KINECT_V1,
    Skeleton,
    positions_from_rotations,
    standard_body,
)
from kinefilter.characters.rotations import normalize
from kinefilter.pipeline.metrics import (
    amplitude,
    bone_length_cv,
    distances,
    flight_error,
    jitter,
    measure,
)

# Bone lengths


@every_skeleton
def test_bones_of_constant_length_do_not_vary_however_they_turn(
    skeleton: Skeleton,
) -> None:
    rng, body = np.random.default_rng(0), standard_body(skeleton)
    rotations = normalize(rng.normal(size=(20, len(skeleton), 4)))
    path = positions_from_rotations(rotations, rng.normal(size=(20, 3)), body)
    assert bone_length_cv(path, body) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("frames", [2, 40])
def test_bone_length_variation_of_a_breathing_body_is_that_of_its_scale(
    frames: int,
) -> None:
    breathing = standing(frames)
    breathing[::2] *= 0.9
    breathing[1::2] *= 1.1
    assert bone_length_cv(breathing, BODY) == pytest.approx(0.1)


def test_one_varying_bone_counts_as_one_of_nineteen() -> None:
    path, hand = standing(40), KINECT_V1.index("HandLeft")
    path[::2, hand] += 0.2 * BODY.rest_offsets[hand]
    path[1::2, hand] -= 0.2 * BODY.rest_offsets[hand]
    assert bone_length_cv(path, BODY) == pytest.approx(0.2 / 19)
    path[::2, hand] = np.nan
    assert bone_length_cv(path, BODY) == pytest.approx(0.0, abs=1e-12)
    path[:, hand] = np.nan
    assert bone_length_cv(path, BODY) == pytest.approx(0.0, abs=1e-12)


def test_bone_length_variation_of_nothing_is_unknown() -> None:
    assert np.isnan(bone_length_cv(np.full((9, 20, 3), np.nan), BODY))
    assert np.isnan(bone_length_cv(standing(1), BODY))
    with np.errstate(all="raise"):
        assert np.isnan(bone_length_cv(np.zeros((9, 20, 3)), BODY))


# Amplitude, distances, all together


def test_amplitude_of_a_sine_is_its_root_mean_square() -> None:
    time, path = stamps(300), standing(300)
    hand = KINECT_V1.index("HandRight")
    path[:, hand, 1] += 0.2 * np.sin(2.0 * np.pi * time)
    path += np.outer(time, [1.0, 0.0, 2.0])[:, None]
    moves = amplitude(path, BODY)
    assert moves[hand] == pytest.approx(0.2 / np.sqrt(2.0))
    assert np.isnan(moves[KINECT_V1.root])
    rest = np.delete(moves, [KINECT_V1.root, hand])
    np.testing.assert_allclose(rest, 0.0, atol=1e-12)


def test_amplitude_skips_missing_frames_and_does_not_know_missing_joints() -> None:
    path, hand = standing(40), KINECT_V1.index("HandRight")
    path[:, hand, 2] += np.tile([0.1, -0.1], 20)
    path[10:20, hand] = np.nan
    path[:, 3] = np.nan
    moves = amplitude(path, BODY)
    assert moves[hand] == pytest.approx(0.1)
    assert np.isnan(moves[3])


def test_distances_are_those_of_numpy_and_nan_where_nothing_was_measured() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 6, 20, 3))
    b[2, 4] = np.nan
    away = distances(a, b)
    np.testing.assert_allclose(away, np.linalg.norm(a - b, axis=-1))
    assert np.argwhere(np.isnan(away)).tolist() == [[2, 4]]


def test_measuring_collects_the_figures_with_their_units() -> None:
    time, raw = stamps(60), standing(60)
    hand = KINECT_V1.index("HandLeft")
    raw[:, hand, 1] += 0.2 * np.sin(2.0 * np.pi * time)
    raw += np.outer(time, [0.3, 0.0, 0.0])[:, None]
    clean = raw.copy()
    clean[:, hand, 1] = standing(60)[:, hand, 1] + 0.1 * np.sin(2.0 * np.pi * time)
    clean += [0.0, -0.03, 0.04]
    stands = np.ones((60, 2), dtype=np.bool_)
    quality = measure(time, clean, raw, BODY, stands)
    assert quality.jitter == pytest.approx(jitter(time, clean))
    assert quality.bone_length_cv == pytest.approx(bone_length_cv(clean, BODY))
    assert quality.skate_mm_per_frame == pytest.approx(10.0)
    assert quality.skate_share_over_0p2 == 1.0
    assert quality.skate_max_m_per_s == pytest.approx(0.3)
    assert quality.penetration_mm == pytest.approx(30.0)
    assert quality.penetration_mean_mm == pytest.approx(30.0)
    assert quality.lowest_point_mm == pytest.approx(-30.0)
    assert quality.float_mm == 0.0
    assert quality.amplitude_kept == pytest.approx(0.5)
    off = distances(clean, raw)
    assert quality.moved_cm == pytest.approx(100.0 * off.mean())
    assert np.delete(off, hand, axis=1).mean() == pytest.approx(0.05)
    assert quality.peak_hand_speed == pytest.approx(0.3)
    assert np.isnan(quality.flight_error)
    higher = measure(time, clean + np.array([0.0, 0.08, 0.0]), raw, BODY, stands)
    assert higher.penetration_mm == higher.penetration_mean_mm == 0.0
    assert higher.float_mm == pytest.approx(50.0)
    flying = measure(time, clean + np.array([0.0, 0.5, 0.0]), raw, BODY, ~stands)
    assert np.isnan(flying.float_mm)
    assert flying.flight_error == pytest.approx(
        flight_error(time, clean + np.array([0.0, 0.5, 0.0]), ~stands, BODY)
    )


def test_penetration_is_that_of_the_deepest_frame_and_the_mean_over_all() -> None:
    time, raw = stamps(60), standing(60)
    clean = raw.copy()
    clean[:, :, 1] += np.repeat([0.01, -0.02, -0.06], 20)[:, None]
    quality = measure(time, clean, raw, BODY, np.ones((60, 2), dtype=np.bool_))
    assert quality.penetration_mm == pytest.approx(60.0)
    assert quality.lowest_point_mm == pytest.approx(-60.0)
    assert quality.penetration_mean_mm == pytest.approx(80.0 / 3.0)


def test_raw_beside_itself_keeps_all_and_empty_frames_do_not_count() -> None:
    time, raw = stamps(60), standing(60)
    raw[:, :4, 0] += 0.1 * np.sin(7.0 * time)[:, None]
    raw[20:25] = np.nan
    raw[:, 7] = np.nan
    quality = measure(time, raw, raw, BODY, np.ones((60, 2), dtype=np.bool_))
    assert quality.amplitude_kept == pytest.approx(1.0)
    assert quality.moved_cm == 0.0
    assert quality.penetration_mm == pytest.approx(0.0, abs=1e-9)
    figures = asdict(quality)
    assert np.isnan(figures.pop("flight_error"))  # no foot ever left the floor
    # Without a joint nobody knows where the mass is.
    assert np.isnan(
        [figures.pop(f"unexplained_{x}") for x in ("force", "moment")]
    ).all()
    assert all(np.isfinite(value) for value in figures.values())
