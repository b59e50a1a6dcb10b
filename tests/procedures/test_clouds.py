"""Golden clouds are fixed, distinct and all round; coverage counts equal areas."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from hiltest.procedures.clouds import golden_cloud
from hiltest.procedures.coverage import CELLS, sphere_coverage


def test_golden_clouds_are_the_same_everywhere() -> None:
    # The digest pins the bytes: cycle counts of different hosts and boards rest on equal clouds.
    digest = hashlib.sha256(b"".join(golden_cloud(n, index=7).astype("<i2").tobytes() for n in (20, 100, 300)))
    assert digest.hexdigest()[:16] == "1070dd5dda9d9e2f"


def test_every_cloud_differs_and_lies_on_its_ellipsoid() -> None:
    clouds = [golden_cloud(100, index=index) for index in range(20)]
    assert len({cloud.tobytes() for cloud in clouds}) == 20
    for cloud in clouds:
        centred = cloud - (cloud.min(axis=0) + cloud.max(axis=0)) / 2.0
        norms = np.linalg.norm(centred, axis=1)
        # 5 % entries move a radius by at most 10 %; mid-range and noise add a few counts more.
        assert norms.min() > 485 * 0.86
        assert norms.max() < 485 * 1.14


def test_an_even_cloud_covers_nearly_all_cells_and_a_cap_few() -> None:
    cloud = golden_cloud(2000)
    assert sphere_coverage(cloud) == 1.0
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    ring = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1) * 485.0
    # A ring lies in one band of ten cells; which side of its middle rounding puts points on may add a second.
    assert 10 / CELLS <= sphere_coverage(ring) <= 20 / CELLS


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((5, 3))])
def test_no_direction_covers_nothing(points: np.ndarray) -> None:
    assert sphere_coverage(points) == 0.0
