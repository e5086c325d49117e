"""The metrics of a report: what they are called and what they are of a motion."""

from __future__ import annotations

from dataclasses import asdict

from kinefilter.pipeline.metrics import Quality

METRICS = {
    "skate": "feet on the floor slide, m per frame",
    "skate_mm_per_frame": "the same, mm per frame",
    "skate_share_over_0p2": "share of their frames over 0.2 m/s",
    "skate_max_m_per_s": "fastest slide of a foot on the floor, m/s",
    "float_mm": "soles of standing feet over the floor, mm",
    "penetration_mm": "deepest point under the floor, mm",
    "penetration_mean_mm": "lowest point under the floor, mean, mm",
    "lowest_point_mm": "height of the lowest point, mm",
    "bone_length_cv": "bone-length variation, share of the length",
    "jitter": "jitter, m/s³",
    "amplitude_kept": "amplitude kept, share of the raw one",
    "peak_hand_speed": "speed of the hands in the fastest 1% of frames, m/s",
    "flight_error": "acceleration in flight off gravity, m/s²",
    "moved_cm": "moved from raw, mean, cm",
}
"""Name and meaning of each metric; names as in ``clean --json``, and ``skate``."""


def figures_of(quality: Quality) -> dict[str, float]:
    """Return a motion's metrics by name, in the order of ``METRICS``; NaN: none."""
    figures = asdict(quality)
    figures["skate"] = figures["skate_mm_per_frame"] * 1e-3
    return {name: float(figures[name]) for name in METRICS}
