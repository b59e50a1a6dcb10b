"""A folder of logs: each is fitted, and parts of it agree as predicted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltest.log_fitting import FieldUnit, Samples
from hiltest.log_fitting.log_folder import agreements, fit_folder

from ..calibration.hand_turned import hand_turned


def _samples(points: np.ndarray) -> Samples:
    return Samples(Path("log.csv"), points, FieldUnit.UT, "option", ("x", "y", "z"), 0)


@pytest.mark.parametrize("calibrator", ["direct", "corrected"])
def test_parts_of_a_log_differ_as_predicted(calibrator: str) -> None:
    results = [
        agreement for seed in range(12) for agreement in agreements(_samples(hand_turned(seed, 1600)), calibrator)
    ]
    assert {entry.cut for entry in results} == {"halves", "tenths"}
    assert len(results) >= 20  # of 24: some halves show too little of the sphere
    within = sum(0.5 <= entry.ratio <= 2.0 for entry in results)
    # A jackknife of 8 blocks, and one draw of the error that it predicts: 87 % of normal ones.
    assert within >= 0.75 * len(results)


def test_a_log_that_changed_state_differs_by_more_than_its_parts_predict() -> None:
    points = hand_turned(1, 1600)
    points[800:] += (6.0, 0.0, 0.0)
    halves = {item.cut: item.ratio for item in agreements(_samples(points), "direct", robust=False)}["halves"]
    assert halves > 2.5


def test_every_file_is_fitted_or_said_to_be_none(tmp_path: Path) -> None:
    (tmp_path / "deeper").mkdir()
    np.savetxt(tmp_path / "deeper" / "b.csv", hand_turned(1, 800), delimiter=",", header="mx_uT,my_uT,mz_uT")
    (tmp_path / "a.txt").write_text("no log at all\n", encoding="utf-8")
    first, second = fit_folder(tmp_path)
    assert (first.name, first.fit, first.unread != "") == ("a.txt", None, True)
    assert str(tmp_path) not in first.unread
    assert (second.name, second.unread) == (str(Path("deeper") / "b.csv"), "")
    assert second.fit is not None
    assert second.fit.n_in == 800
    assert second.agreements
