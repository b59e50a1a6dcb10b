"""An accelerometer that was never trimmed: with and without its six faces, and on faces that a hand laid it on."""

from __future__ import annotations

from pathlib import Path

import pytest

from .conftest import RIGS, Finished, Run

BY_HAND = "virtual-k64f-hand-laid"


@pytest.fixture(scope="module")
def untrimmed(run_in: Run, tmp_path_factory: pytest.TempPathFactory) -> Finished:
    return run_in(tmp_path_factory.mktemp("untrimmed"), "--rig", "virtual-k64f-untrimmed")


def test_six_faces_make_a_heading_of_five_degrees_one_of_two(untrimmed: Finished) -> None:
    assert untrimmed.code == 0, untrimmed.output
    assert untrimmed.value("heading.direct-untrimmed.max") >= 4.8
    assert untrimmed.value("heading.direct.max") <= 2.0
    assert untrimmed.measured["heading.direct-untrimmed.max"]["limit"] == {"max": None, "min": 4.8}


def test_gravity_is_judged_at_poses_that_no_fit_has_seen(untrimmed: Finished) -> None:
    # 20 mg on three axes and 2.5 %: simulated 41.7 mg; after six faces within 0.1 degree 0.42.
    assert untrimmed.value("accelerometer.untrimmed_norm_rms") == pytest.approx(41.7, abs=0.5)
    assert untrimmed.value("accelerometer.six_position.norm_rms") < 1.0
    assert untrimmed.value("accelerometer.norm_rms") == pytest.approx(
        untrimmed.value("accelerometer.six_position.norm_rms"), rel=1e-4
    )


def test_faces_askew_by_a_degree_leave_offset_and_gain_alone_and_are_measured(run_in: Run, tmp_path: Path) -> None:
    run = run_in(tmp_path, "--rig", BY_HAND, "--", "-k", "identity or accelerometer or heading")
    assert run.code == 0, run.output
    assert run.value("accelerometer.faces_askew") == pytest.approx(1.0, abs=0.05)
    assert run.value("accelerometer.six_position.offset_error") < 0.9
    # What they leave of the axes is of the order of what the part itself is askew by.
    assert 0.2 < run.value("accelerometer.six_position.axis_error") < 1.2


def test_a_limit_that_such_faces_cannot_bear_is_refused_with_their_angle(run_in: Run, tmp_path: Path) -> None:
    text = (RIGS / f"{BY_HAND}.toml").read_text(encoding="utf-8")
    wide = '"heading.direct.max" = { max = 2.8,'
    assert text.count(wide) == 1
    (tmp_path / "tight.toml").write_text(text.replace(wide, '"heading.direct.max" = { max = 1.8,'), encoding="utf-8")
    run = run_in(tmp_path, "--rig", "tight.toml", "--", "-k", "identity or six_faces_are_fitted")
    assert run.code == 1
    assert "the faces were askew by 1.00 deg rms, too much for limits.heading.direct.max of 1.8 deg" in run.output
    assert "accelerometer.faces_askew" not in run.measured
