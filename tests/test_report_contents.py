"""What a report's page is told of takes that are far off or hardly there."""

from __future__ import annotations

import numpy as np

from kinefilter.pipeline.look import page


def test_a_curve_of_one_joint_is_that_joints() -> None:
    time, positions = np.arange(10) / 30.0, np.zeros((10, 20, 3))
    positions[:, :, 0] = time[:, None]
    positions[:, 1:] = np.nan
    np.testing.assert_allclose(page._derivative(time, positions, 1)[:-1], 1.0)


def test_joints_out_of_the_reach_of_a_page_are_at_its_edge() -> None:
    written = page.millimeters(np.array([0.25, 40.0, -40.0, np.nan]))
    assert written.tolist() == [250.0, 32767.0, -32767.0, -32768.0]
