"""Heading errors that angles set by hand cause by themselves, and the limits that they leave out of reach."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import median

import numpy as np

from hiltest.orientation.angles import Pose
from hiltest.procedures.heading_statistics import summarise
from hiltest.rig import Rig
from hiltest.text import format_number

_DRAWS = 400  # determine the medians to some per cent
_STATISTICS = ("max", "rms", "bias", "max_centred")
_FAULT = "Even a perfect compass meets these limits in fewer than half of all runs, as the angles are so uncertain:\n"
_REMEDY = (
    "To lower U, set the angles more accurately and correct uncertainty_deg under [turntable] and [mounting]. If the "
    "errors of the angles are independent, fewest_poses = true under [turntable] also helps.\n"
)


def angle_errors_deg(rig: Rig, poses: Sequence[Pose]) -> Mapping[str, float]:
    """Return the medians of the statistics of heading errors over the poses that a perfect compass shows [deg].

    Its errors are those of the angles: independent ones of setting the table, and a common one of the mounting, both
    normal with half of the declared uncertainty as standard deviation. Empty unless an operator turns the board and all
    poses are measured.
    """
    if rig.turntable.kind != "operator" or rig.turntable.fewest_poses:
        return {}
    draws = np.random.default_rng(1)
    errors_deg = draws.normal(0.0, rig.turntable.uncertainty_deg / 2.0, (_DRAWS, len(poses)))
    errors_deg += draws.normal(0.0, rig.mounting.uncertainty_deg / 2.0 if rig.mounting else 0.0, (_DRAWS, 1))
    summaries = [summarise(row, [pose.heading_deg for pose in poses]) for row in errors_deg]
    return {
        statistic: median(abs(getattr(summary, f"{statistic}_deg") or 0.0) for summary in summaries)
        for statistic in _STATISTICS
    }


def limits_out_of_reach(rig: Rig, poses: Sequence[Pose]) -> str:
    """Name the limits that even a perfect compass meets in fewer than half of all runs; empty without any.

    A value meets its limit if it is within by at least U, and `angle_errors_deg` are values of a perfect compass.
    """
    errors_deg, faults = angle_errors_deg(rig, poses), dict[str, list[str]]()
    for name, limit in rig.limits.items():
        error_deg, uncertainty_deg = errors_deg.get(name.rpartition(".")[2]), rig.guard_band_deg(name)
        if error_deg is None or uncertainty_deg is None or limit.max is None:
            continue
        bound_deg, needed_deg = min(limit.max, abs(limit.min or limit.max)), error_deg + uncertainty_deg
        if bound_deg < needed_deg:
            least_deg, most_deg = math.ceil(10.0 * needed_deg) / 10.0, uncertainty_deg * bound_deg / needed_deg
            fault = (
                f"{limit} deg with U {format_number(uncertainty_deg, 2)}: raise it above {least_deg:g}, or lower U "
                f"below {most_deg:.2f}."
            )
            faults.setdefault(fault, []).append(name)
    lines = "".join(f"{', '.join(names)} {fault}\n" for fault, names in faults.items())
    return f"{_FAULT}{lines}{_REMEDY}" if lines else ""
