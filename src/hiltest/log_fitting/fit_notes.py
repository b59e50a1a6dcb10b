"""Notes for readers of a fit of recorded samples, in sentences."""

from __future__ import annotations

from collections.abc import Iterator

from hiltest.calibration.acceptance import LARGEST_AXIS_RATIO, Acceptance
from hiltest.calibration.robust import FURTHEST, MANY_LEFT_OUT
from hiltest.log_fitting.asked_units import asked_of_field
from hiltest.log_fitting.fit_result import SampleFit
from hiltest.measurement.units import MICROTESLA, FieldUnit

# Number of runs of omitted readings that a sentence names.
_NAMED_RUNS = 8


def notes(fit: SampleFit) -> Iterator[str]:
    """Yield notes on a fit, one sentence each."""
    if MICROTESLA[FieldUnit(fit.unit)] is None:
        why = "The header has no known unit: the readings count as counts" if fit.unit_from == "assumed" else "Counts"
        yield f"{why} of unknown scale, so the field strength is not checked; set the unit with --unit uT or gauss."
    # The radius of a shape other than an ellipsoid may differ from the field's strength.
    refused = {reason.figure for reason in fit.best.reasons if reason.verdict is Acceptance.REFUSED}
    if fit.best.radius is not None and not (fit.best.shape is not None or fit.at_rest or "condition" in refused):
        yield from asked_of_field(fit.best.radius, FieldUnit(fit.unit), fit.unit_from)
    if fit.n_skipped:
        yield f"{fit.n_skipped} rows without three finite numbers were skipped."
    if fit.change is not None:
        at = f"{fit.change.at:.4g}"
        yield (
            f"The field changed {fit.change.when}: the hard iron changes by {fit.change.percent:.1f} % of the radius. "
            f"--to {at} or --from {at} selects one part of the log, --steady the longest part without a change."
        )
    if fit.growth_percent is not None:
        yield (
            f"The field's strength changed by {fit.growth_percent:+.1f} % over the log: the sensor warmed "
            "up, or moved to another place."
        )
    if fit.at_rest:
        yield "The sensor was at rest: the readings are a small ball of noise. Turn it in all directions while you log."
    elif not fit.in_order:
        yield (
            "The rows are not in order of time: a reading is as far from the next as from any other. The predicted "
            "direction error assumes independent noise, and a changed field cannot be detected."
        )
    yield from _left_out_notes(fit)
    yield from _coverage_notes(fit)
    if fit.worse_than_none:
        yield f"{', '.join(fit.worse_than_none)}: worse than as read, without calibration; do not use it."
    if measured := [result.name for result in fit.calibrators if result.error_is_measured]:
        yield (
            f"The direction error of {', '.join(measured)} is measured, against the ellipsoid of the same samples; "
            "others are predicted from the noise."
        )
    if fit.gravity is not None and fit.gravity.unused:
        yield fit.gravity.axes or f"Gravity was not used: {fit.gravity.unused}."
    ratio = fit.best.axis_ratio
    if ratio is not None and ratio > LARGEST_AXIS_RATIO:
        yield (
            f"The ellipsoid is {ratio:.1f} times as long as wide, more than the iron of a board can cause: check "
            "that these are the columns of one magnetometer, with the same scale."
        )
    if fit.best.shape is not None:
        return
    used, n_left = fit.calibrators[0].n_used, fit.n_left
    if used != n_left:
        yield f"The board got {used} of {n_left} points, its capacity, chosen evenly on the sphere."
    if fit.firmware is not None:
        shifted = " from the middle of their range" if any(fit.firmware.count_origin) else ""
        yield (
            f"The firmware got int16 numbers, 1 for {fit.firmware.count_step:.4g} {fit.unit}{shifted}; rounding moved "
            f"a reading by {fit.firmware.rounding_rms:.2g} {fit.unit} rms."
        )


def _coverage_notes(fit: SampleFit) -> Iterator[str]:
    """Yield notes on the coverage of the sphere, and on how to improve it."""
    best = fit.best
    if best.turn is not None:
        yield (
            f"{best.name}: the sensor turned about an axis {best.turn.tilt_deg:.0f} deg off its {best.turn.axis}, by "
            f"{best.turn.arc_deg:.0f} deg. The calibration corrects nothing along that axis."
        )
    elif fit.hole is not None and {reason.figure for reason in best.reasons} & {"condition", "shape"}:
        yield (
            f"The largest hole has a radius of {fit.hole.radius_deg:.0f} deg, about the sensor's {fit.hole.axes}: "
            "turn it into the direction of the field, north and down (south of the equator north and up)."
        )
    if fit.field_ut is not None and best.radius is not None and (unit := MICROTESLA[FieldUnit(fit.unit)]) is not None:
        yield f"The radius is {best.radius * unit / fit.field_ut:.2f} of the field of --field."


def _left_out_notes(fit: SampleFit) -> Iterator[str]:
    if fit.n_repeated >= MANY_LEFT_OUT * fit.n_in:
        done = "were left out" if fit.robust != "none" else "count as independent"
        yield (
            f"{fit.n_repeated} of {fit.n_in} readings repeat the one before and {done}: the log is faster than the "
            "sensor, or the sensor lay still."
        )
    if not fit.n_dropped:
        return
    runs = [f"{first}" if first == last else f"{first} to {last}" for first, last in fit.dropped]
    more = f" and {len(runs) - _NAMED_RUNS} more places (--json has all)" if len(runs) > _NAMED_RUNS else ""
    kind = "lines" if len(runs) > 1 or " to " in runs[0] else "line"
    own = fit.n_in - fit.n_repeated
    among = f"the {own} readings that repeat none" if fit.n_repeated else f"{own} readings"
    repeated = ", with their repeats" if fit.n_repeated else ""
    yield (
        f"{fit.n_dropped} of {among} were left out, further than {FURTHEST:g} times the scatter "
        f"from the ellipsoid of the others: {kind} {', '.join(runs[:_NAMED_RUNS])}{more}{repeated}."
    )
    if fit.n_dropped > MANY_LEFT_OUT * own:
        yield "So many may have affected the fit: check --html, and use the part of the log without them."
