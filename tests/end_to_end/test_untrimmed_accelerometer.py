"""An accelerometer that was never trimmed: with and without its six faces, in one run."""

from __future__ import annotations

from pathlib import Path

import pytest

from .conftest import Finished, Run


@pytest.fixture(scope="module")
def untrimmed(run_in: Run, tmp_path_factory: pytest.TempPathFactory) -> Finished:
    return run_in(tmp_path_factory.mktemp("untrimmed"), "--rig", "virtual-k64f-untrimmed")


def test_six_faces_make_a_heading_of_four_degrees_one_of_two(untrimmed: Finished) -> None:
    assert untrimmed.code == 0, untrimmed.output
    assert untrimmed.value("heading.direct-untrimmed.max") >= 4.0
    assert untrimmed.value("heading.direct.max") <= 2.0
    assert untrimmed.measured["heading.direct-untrimmed.max"]["limit"] == {"max": None, "min": 4.0}


def test_gravity_is_judged_at_poses_that_no_fit_has_seen(untrimmed: Finished) -> None:
    # 20 mg on three axes and 2.5 %: simulated 42.7 mg; after six faces within 0.1 degree 0.44.
    assert untrimmed.value("accelerometer.untrimmed_norm_rms") == pytest.approx(42.7, abs=0.5)
    assert untrimmed.value("accelerometer.six_position.norm_rms") < 1.0
    assert untrimmed.value("accelerometer.norm_rms") == pytest.approx(
        untrimmed.value("accelerometer.six_position.norm_rms"), rel=1e-4
    )


def test_another_seed_shows_the_same(run_in: Run, tmp_path: Path) -> None:
    run = run_in(tmp_path, "--rig", "virtual-k64f-untrimmed", "--seed", "2", "--", "-k", "heading or accelerometer")
    assert run.code == 0, run.output
    assert run.value("heading.direct-untrimmed.max") >= 4.0
    assert run.value("heading.direct.max") <= 2.0
