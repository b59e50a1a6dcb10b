"""Golden clouds are fixed, distinct and all round."""

from __future__ import annotations

import hashlib

import numpy as np

from hiltest.procedures.coverage import largest_uncovered_cap
from hiltest.procedures.golden_points import golden_points


def test_golden_clouds_are_the_same_everywhere() -> None:
    # The digest pins the bytes: cycle counts of different hosts and boards rest on equal clouds.
    digest = hashlib.sha256(b"".join(golden_points(n, index=7).astype("<i2").tobytes() for n in (20, 100, 300)))
    assert digest.hexdigest()[:16] == "1070dd5dda9d9e2f"


def test_every_cloud_differs_and_lies_on_its_ellipsoid() -> None:
    clouds = [golden_points(100, index=index) for index in range(20)]
    assert len({cloud.tobytes() for cloud in clouds}) == 20
    for cloud in clouds:
        centred = cloud - (cloud.min(axis=0) + cloud.max(axis=0)) / 2.0
        norms = np.linalg.norm(centred, axis=1)
        # 5 % entries move a radius by at most 10 %; mid-range and noise add a few counts more.
        assert norms.min() > 485 * 0.86
        assert norms.max() < 485 * 1.14


def test_a_golden_cloud_has_no_hole() -> None:
    for n in (20, 100, 300):
        # A cap with n even neighbours: half the angle between them is near sqrt(4 pi / n) / 2; 1.7 of it is a corner.
        assert largest_uncovered_cap(golden_points(n), field_ut=48.5)[0] < 1.7 * np.degrees(np.sqrt(np.pi / n))
