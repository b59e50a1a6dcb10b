"""Limits that nothing was measured against: a gate that is not evaluated fails closed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from hiltest.measurement import Limit, Measurement, Outcome, Section, identify

_CALIBRATOR = "{calibrator}"
_UNCALIBRATED = "uncalibrated"
_UNTRIMMED = "-untrimmed"
# Calibrations that no calibrator of the firmware makes of the tumble's points, and why there may be none.
_OF_STILL_POSES = "dpi-poses"
_OTHERWISE = {
    **dict.fromkeys(("dpi", _OF_STILL_POSES), 'procedure.dpi is "none", or its fit was refused'),
    "calibration": "no calibration file was named with --calibration",
}


def unmet_limits(
    limits: Mapping[str, Limit], units: Mapping[str, str], measured: Collection[str], calibrators: Sequence[str],
    *, gate_only: bool = False,
) -> list[Measurement]:
    """Return an ``unset`` measurement for every limit of the rig that no measurement met.

    Parameters
    ----------
    limits, units : mapping
        Of the rig, by measurement name.
    measured : collection of str
        Names of all that was measured.
    calibrators : sequence of str
        That the board offers; empty when no board answered.
    gate_only : bool, optional
        Whether there are tests that were left out because they are of the full set.
    """
    return [
        Measurement(
            name, None, units.get(name, ""), limit=limit, outcome=Outcome.UNSET, note=_why(name, calibrators, gate_only)
        )
        for name, limit in limits.items() if name not in measured
    ]


def _why(name: str, calibrators: Sequence[str], gate_only: bool) -> str:
    named = identify(name)
    calibrator, _, points = named.subject.removesuffix(_UNTRIMMED).partition("@")
    waits = gate_only and calibrator == _OF_STILL_POSES
    if named.kind and _CALIBRATOR in named.kind.name and named.section is not Section.STREAMS and not waits:
        if calibrator in _OTHERWISE:
            return f"nothing measured it; {_OTHERWISE[calibrator]}"
        if calibrators and calibrator not in (*calibrators, _UNCALIBRATED):
            return f"the board has no calibrator {calibrator!r}, only {', '.join(calibrators)}"
    if points:
        return f"nothing measured it; procedure.further_calibrations names no {calibrator}@{points}, or its fit failed"
    return "nothing in the gate set measured it" if gate_only else "nothing measured it"
