"""The kinds of measurement that hiltest makes: the one table of their names, units and meaning.

A name such as ``heading.{calibrator}.max`` declares its subject in braces; `identify` finds the kind and the subject of
``heading.direct.max``. A measurement with any other name is the user's own: it has no kind.

Remarks such as "moved by 0.04" were measured on the default rig over seeds 1 to 8 (the full set: 1 to 4): the packaged
firmware was compared with builds of itself with other flags: ``-O3`` (other times, the same rounding),
``-fassociative-math`` and ``-ffp-contract=fast`` (sums in another order, multiply-adds rounded once). On a virtual
board noise is a function of seed and sample, so the effect of such a build is the largest that a harmless change can
have. `hiltest.measurement.deviations` has the effect of noise.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import product

from hiltest.measurement.deviations import DEVIATIONS
from hiltest.measurement.kind import (
    COSTS_TOO_MUCH,
    EXACT,
    Allowance,
    Better,
    Deviation,
    Kind,
    NamedKind,
    Reference,
    Section,
    Tolerance,
)
from hiltest.measurement.limit import Limit


def _allow(absolute: float, relative: float, reason: str, better: Better | None = None) -> Allowance:
    return Allowance(Tolerance(absolute, relative), reason, better)


_MOTION = "sampled in motion, at times that any other firmware shifts by microseconds"
_COUNTED = _allow(0, 0, "counted, not measured")
_KERNEL = _allow(0, 0, "virtual cycles of one call are the same on every machine: one more is one more")
_PER_CALL_WHY = "of calls whose number depends on the data; half a percent is less than an instruction in a loop of 100"
_LINE = "slope or intercept of a line through few sizes; one instruction a point is 1 % of the cheapest calibrator"
_ROUNDING = "float32 in another order moved it by less than a hundredth of this"
_IN_FLOAT64 = "Compare the firmware's arithmetic with the float64 reference: no sensor enters this difference."
_ALL_ROUND = "Turn the board through more directions: the points of the tumble have to cover the sphere."
_AT_REST = "Keep the board still while the gyroscope's bias is taken, and wait until its temperature is steady."
_GROWTH = "a hundredth is what a correction takes; what takes more is to be seen"
_FRAME = "a few saved registers, as another version of a compiler has them"
_CALLED = "of what was called, and another set of tests calls more or less"
_OF_PART = "of the simulated parts or of the rig: no firmware should move it"

_LOWER, _HIGHER, _ZERO, _NEITHER = Better.LOWER, Better.HIGHER, Better.NEARER_ZERO, Better.NEITHER
_TABLE, _MOUNTED = Reference.TURNTABLE, Reference.MOUNTED
_WORST = "heading.{calibrator}.max"


def _kinds() -> Iterator[Kind]:
    yield from _heading()
    yield from _cycles()
    yield from _streams()
    yield from _fit()
    yield from _imu()
    yield from _fusion()
    yield from _driving()
    yield from _own_language()
    yield from _board()
    yield from _studies()


def _heading() -> Iterator[Kind]:
    in_motion = _allow(0.1, 0.05, f"moved by 0.040; {_MOTION}")
    held = _allow(0.01, 0.01, _ROUNDING)
    raw = _allow(0.01, 0, _OF_PART, _NEITHER)
    for quantity, meaning, reference in (
        ("max", "Largest heading error over the known angles", _MOUNTED),
        ("max_centred", "Largest heading error once the mean error is subtracted", _TABLE),
        ("rms", "Root mean square of the heading errors over the known angles", _MOUNTED),
    ):
        subjects = {"dpi": in_motion} | ({"uncalibrated": raw} if quantity == "max" else {})
        rms = "" if quantity == "rms" else "heading.{calibrator}.rms"
        yield Kind(
            f"heading.{{calibrator}}.{quantity}",
            "deg",
            _LOWER,
            held,
            Section.HEADING,
            meaning,
            subjects,
            reference=reference,
            decided_by=rms,
        )
    yield Kind(
        "heading.{calibrator}.bias",
        "deg",
        _ZERO,
        _allow(0.01, 0.01, _ROUNDING),
        Section.HEADING,
        "Circular mean of the heading errors",
        {"dpi": _allow(0.05, 0.05, f"moved by 0.003; {_MOTION}")},
        reference=_MOUNTED,
    )
    yield Kind(
        "heading.{calibrator}.tilt_sensitivity",
        "deg",
        _ZERO,
        _allow(0.01, 0.01, _ROUNDING),
        Section.HEADING,
        "rms heading error over the tilted poses less that over the level ones",
        {"dpi": _allow(0.05, 0.05, f"moved by 0.015; {_MOTION}")},
        reference=_TABLE,
    )
    yield Kind(
        "heading.{calibrator}.worst_sector",
        "deg",
        _NEITHER,
        _allow(0, 0, "which of the sectors: no quantity"),
        Section.HEADING,
        "Start of the sector of 30 degrees of heading that holds the largest error",
        direction=True,
    )
    yield Kind(
        "heading.{calibrator}.float32_error",
        "deg",
        _LOWER,
        _allow(5e-4, 0, "moved by 3.3e-5; a wrong kernel differs by far more"),
        Section.HEADING,
        "Largest difference between the board's heading and the same computed in float64 on the host",
        {"dpi": _allow(5e-4, 0, f"moved by 1.2e-4; {_MOTION}")},
        next_step=_IN_FLOAT64,
    )
    yield Kind(
        "heading.uncalibrated.max_level",
        "deg",
        _NEITHER,
        raw,
        Section.HEADING,
        "Largest heading error without calibration over the level poses",
        reference=_MOUNTED,
    )
    yield Kind(
        "tumble.points",
        "",
        _HIGHER,
        _COUNTED,
        Section.HEADING,
        "Calibration points that the board collected while it was tumbled",
        next_step=_ALL_ROUND,
    )
    yield Kind(
        "tumble.coverage",
        "%",
        _HIGHER,
        _allow(0.5, 0.01, "half a percent is a sixth of one of 300 directions"),
        Section.HEADING,
        "Share of the sphere that the calibration points cover",
        next_step=_ALL_ROUND,
    )


def _cycles() -> Iterator[Kind]:
    line = _allow(0.5, 0.005, _LINE)
    for quantity, unit, better, allowance, meaning in (
        ("total", "cycle", _LOWER, _KERNEL, "Cycles of one calibration from the number of points that the rig states"),
        ("per_point", "cycle", _LOWER, line, "Slope of the line through the cycles at several numbers of points"),
        ("fixed", "cycle", _LOWER, _allow(5, 0.01, _LINE), "Intercept of that line: cycles whatever the points"),
        (
            "regression_residual",
            "cycle",
            _NEITHER,
            _allow(1, 0.05, "how well the line describes the calls, not what they cost"),
            "Largest distance of a count from that line",
        ),
        ("worst_found", "cycle", _LOWER, _KERNEL, "Most cycles that a search over inputs has found: its input again"),
        (
            "spread",
            "cycle",
            _LOWER,
            _allow(5, 0.05, "between the cheapest and the dearest of some point sets"),
            "Most less fewest cycles over several sets of as many points",
        ),
        ("per_iteration", "cycle", _LOWER, line, "Cycles of one sweep of an iterative solver"),
        ("store_per_point", "cycle", _LOWER, _KERNEL, "Cycles to store one point for a fit, where that prepares it"),
    ):
        yield Kind(
            f"cycles.{{calibrator}}.{quantity}",
            unit,
            better,
            allowance,
            Section.CYCLES,
            meaning,
            accuracy=_WORST if better is _LOWER else "",
        )
    yield Kind(
        "cycles.{calibrator}.from_flash",
        "cycle",
        _NEITHER,
        _allow(0, 0.1, "what the flash makes of a function moves by as much from one link to the next"),
        Section.CYCLES,
        "Cycles of `total`, with the waits of the memories that it runs from",
    )
    yield Kind(
        "cycles.{calibrator}.sweeps",
        "",
        _NEITHER,
        _allow(0, 0, "counted; what they cost is in the total"),
        Section.CYCLES,
        "Sweeps that an iterative solver took",
    )
    instructions = _allow(0, 0.01, "what they cost is in the total")
    yield Kind(
        "cycles.{calibrator}.instructions",
        "instruction",
        _NEITHER,
        instructions,
        Section.CYCLES,
        "Instructions of the calibration of `total`",
    )
    yield Kind(
        "cycles.{calibrator}.instructions_per_sweep",
        "instruction",
        _NEITHER,
        instructions,
        Section.CYCLES,
        "Instructions of one sweep of an iterative solver",
    )
    yield Kind(
        "cycles.{calibrator}.float64_distance",
        "deg",
        _LOWER,
        _allow(5e-4, 0, "of golden points; as heading.{calibrator}.float32_error"),
        Section.CYCLES,
        "rms angle between directions under the board's fit and under a float64 fit of the same points",
        next_step=_IN_FLOAT64,
    )
    yield Kind(
        "cycles.fusion.{step}",
        "cycle",
        _LOWER,
        _KERNEL,
        Section.FUSION,
        "Most cycles of one prediction (predict) or correction (update) of the fusion filter",
        accuracy="fusion.heading.max",
        next_step=COSTS_TOO_MUCH,
    )
    yield Kind(
        "cycles.fusion.{step}.mean",
        "cycle",
        _LOWER,
        _allow(0.5, 0.005, _PER_CALL_WHY),
        Section.FUSION,
        "Mean cycles of one prediction or correction of the fusion filter",
        accuracy="fusion.heading.max",
        next_step=COSTS_TOO_MUCH,
    )
    yield Kind(
        "cycles.gyroscope-turns.total",
        "cycle",
        _LOWER,
        _KERNEL,
        Section.GYROSCOPE,
        "Cycles of the fit of scale and axes to three turns",
        next_step=COSTS_TOO_MUCH,
    )


def _streams() -> Iterator[Kind]:
    per_call = _allow(1, 0.005, _PER_CALL_WHY)
    for quantity, unit, better, allowance, meaning in (
        ("cycles_mean", "cycle", _LOWER, per_call, "Mean cycles to take one point"),
        ("cycles_median", "cycle", _LOWER, per_call, "Median cycles to take one point"),
        ("cycles_max", "cycle", _LOWER, _allow(5, 0.005, _PER_CALL_WHY), "Most cycles to take one point"),
        ("fit_cycles", "cycle", _LOWER, _KERNEL, "Cycles of the fit when it is asked for, after all points"),
        ("total", "cycle", _LOWER, _allow(300, 0.005, _PER_CALL_WHY), "Cycles of all points of the tumble"),
        ("remove_mean", "cycle", _LOWER, _KERNEL, "Mean cycles to remove one point"),
        ("remove_max", "cycle", _LOWER, _KERNEL, "Most cycles to remove one point"),
        ("held", "", _NEITHER, _allow(0, 0, "counted, not measured"), "Points that the calibration is made of"),
        ("elements", "", _HIGHER, _COUNTED, "Unknowns of the solver that made the calibration"),
        ("refused", "", _LOWER, _COUNTED, "Points that the calibrator refused"),
    ):
        cost = unit == "cycle"
        yield Kind(
            f"stream.{{calibrator}}.{quantity}",
            unit,
            better,
            allowance,
            Section.STREAMS,
            meaning,
            accuracy=_WORST if cost else "",
            next_step=COSTS_TOO_MUCH if cost else "",
            decided_by="stream.{calibrator}.cycles_mean" if quantity in ("cycles_median", "cycles_max") else "",
        )


def _fit() -> Iterator[Kind]:
    for quantity, unit, better, allowance, meaning, dpi in (
        (
            "status",
            "",
            _LOWER,
            _allow(0, 0, "0 is the fit that was asked for, all others are less"),
            "Status of the fit: 0 is the ellipsoid that was asked for, any other says why there is none",
            None,
        ),
        ("n_used", "", _HIGHER, _COUNTED, "Pairs of field and gravity that the fit used", None),
        (
            "coverage",
            "",
            _LOWER,
            _allow(0.01, 0.01, _ROUNDING),
            "Largest ratio of a diagonal element of the normal equations to its pivot: lower for points all round",
            _allow(0.05, 0.02, f"moved by 0.012; {_MOTION}"),
        ),
        (
            "residual",
            "%",
            _LOWER,
            _allow(0.005, 0.005, f"moved by 0.0007; {_MOTION}"),
            "rms deviation of the calibrated field strength from its mean",
            None,
        ),
        (
            "residual_predicted",
            "%",
            _NEITHER,
            _allow(1e-4, 0, _OF_PART),
            "Residual that sensor noise alone leaves",
            None,
        ),
        (
            "offset_error",
            "uT",
            _LOWER,
            _allow(0.005, 0.01, _ROUNDING),
            "Distance of the hard iron from its truth",
            _allow(0.02, 0.05, f"moved by 0.005; {_MOTION}"),
        ),
        (
            "rotation_left",
            "deg",
            _LOWER,
            _allow(0.005, 0.01, _ROUNDING),
            "Residual rotation: how far calibrated directions are turned from the true ones",
            _allow(0.05, 0.05, f"moved by 0.020; {_MOTION}"),
        ),
        (
            "standard_error",
            "%",
            _LOWER,
            _allow(0.02, 0.02, f"moved by 0.005; {_MOTION}"),
            "Standard error of the fitted matrix",
            None,
        ),
        (
            "dip",
            "deg",
            _NEITHER,
            _allow(0.02, 0, f"moved by 0.005; {_MOTION}"),
            "Dip of the field that the fit against gravity found",
            None,
        ),
        ("dip_declared", "deg", _NEITHER, _allow(0, 0, _OF_PART), "Dip that the rig declares", None),
        (
            "strength",
            "uT",
            _NEITHER,
            _allow(0.02, 0, f"moved by 0.002; {_MOTION}"),
            "Strength of the field that the fit against gravity found",
            None,
        ),
        ("strength_declared", "uT", _NEITHER, _allow(0, 0, _OF_PART), "Field strength that the rig declares", None),
    ):
        yield Kind(
            f"fit.{{calibrator}}.{quantity}", unit, better, allowance, Section.FIT, meaning, {"dpi": dpi} if dpi else {}
        )
    yield Kind(
        "budget.{calibrator}.effort",
        None,
        _HIGHER,
        _allow(0, 0, "effect of the budget: follows from exact cycles"),
        Section.BUDGET,
        "Points, or sweeps of an iterative solver, that the thesis' cycle budget pays for",
    )
    yield Kind(
        "budget.{calibrator}.mean_error",
        "deg",
        _LOWER,
        _allow(0.25, 0.02, "moved by 0.14, by one point more of 16"),
        Section.BUDGET,
        "Mean heading error of a calibration with that effort",
    )


def _imu() -> Iterator[Kind]:
    small = _allow(0.005, 0.01, _ROUNDING)
    norm = _allow(0.01, 0.01, _ROUNDING)
    of_part = _allow(0.01, 0.01, _OF_PART)
    for name, unit, better, allowance, meaning in (
        ("norm_rms", "mg", _LOWER, norm, "rms deviation of gravity from 1 g at the known angles"),
        ("tilt_error", "deg", _LOWER, small, "Largest error of pitch and roll at the known angles"),
        (
            "untrimmed_norm_rms",
            "mg",
            _NEITHER,
            _allow(0.01, 0.01, _OF_PART),
            "rms deviation of gravity from 1 g on the faces, before calibration",
        ),
        ("rest_norm_error", "mg", _NEITHER, of_part, "Deviation of gravity from 1 g at rest, before calibration"),
        (
            "faces_askew",
            "deg",
            _NEITHER,
            of_part,
            "Misalignment of the six faces by their readings, rms about each axis",
        ),
        ("{fit}.norm_rms", "mg", _LOWER, norm, "rms deviation of gravity from 1 g under this calibration"),
        ("{fit}.tilt_error", "deg", _LOWER, small, "Largest error of pitch and roll under this calibration"),
        ("{fit}.axis_error", "deg", _LOWER, small, "Largest angle between a calibrated axis and the true one"),
        ("{fit}.offset_error", "mg", _LOWER, small, "Distance of the fitted offset from its truth"),
        ("{fit}.residual", "mg", _LOWER, norm, "rms deviation of gravity from 1 g over the fit's own poses"),
        ("{fit}.cycles", "cycle", _LOWER, _KERNEL, "Cycles of the fit"),
    ):
        accuracy = "accelerometer.{fit}.norm_rms" if unit == "cycle" else ""
        yield Kind(
            f"accelerometer.{name}",
            unit,
            better,
            allowance,
            Section.ACCELEROMETER,
            meaning,
            accuracy=accuracy,
            next_step=COSTS_TOO_MUCH if unit == "cycle" else "",
        )
    yield Kind(
        "magnetometer.{fit}.norm_rms",
        "%",
        _LOWER,
        _allow(0.005, 0.01, _ROUNDING),
        Section.FIT,
        "rms deviation of the field strength under this calibration from its mean",
    )
    yield from _gyroscope()


def _gyroscope() -> Iterator[Kind]:
    scale = _allow(0.02, 0.02, f"moved by 0.008; {_MOTION}")
    axes = _allow(0.005, 0.02, _ROUNDING)
    bias = _allow(0.001, 0.01, _ROUNDING)
    turn = _allow(0.05, 0.02, f"moved by 0.020; {_MOTION}")
    sensitivity = _allow(0.02, 0, f"moved by 0.008; {_MOTION}")
    for name, unit, better, allowance, meaning in (
        ("bias_error", "dps", _LOWER, bias, "Distance of the measured bias from its truth"),
        ("uncorrected_error", "dps", _NEITHER, _allow(0.01, 0, _OF_PART), "Rate at rest before the bias is subtracted"),
        (
            "temperature",
            "degC",
            _NEITHER,
            _allow(1, 0, "the part gives whole degrees"),
            "Temperature that the part reports",
        ),
        ("scale_error", "%", _ZERO, scale, "Largest error of scale over the three axes"),
        ("scale_error.{axis}", "%", _ZERO, scale, "Error of scale of one axis"),
        ("misalignment", "deg", _LOWER, axes, "Largest angle between a calibrated axis and the true one"),
        ("misalignment.{axis}", "deg", _LOWER, axes, "Angle between one calibrated axis and the true one"),
        ("sensitivity_error.{axis}", "%", _NEITHER, sensitivity, "Error of one axis' scale before calibration"),
        ("scale_uncertainty", "%", _LOWER, axes, "Uncertainty of scale that follows from the table's angle"),
        ("misalignment_uncertainty", "deg", _LOWER, axes, "Uncertainty of the axes that follows from the table's tilt"),
        ("turn_error", "deg", _LOWER, turn, "Error of a whole turn that the calibration was not fitted to"),
        (
            "noise_density",
            "mdps/rtHz",
            _NEITHER,
            _allow(0.5, 0.02, f"moved by 0.15; {_MOTION}"),
            "Largest noise density of the three axes at rest",
        ),
        ("{fit}.bias_error", "dps", _LOWER, bias, "Distance of the bias of this calibration from its truth"),
        ("{fit}.turn_error", "deg", _LOWER, turn, "Error of a whole turn under this calibration"),
        (
            "{fit}.largest_turn_error",
            "deg",
            _LOWER,
            turn,
            "Largest error of whole turns about all axes under this calibration",
        ),
    ):
        yield Kind(
            f"gyroscope.{name}",
            unit,
            better,
            allowance,
            Section.GYROSCOPE,
            meaning,
            next_step=_AT_REST if unit in ("dps", "degC") else "",
        )


def _fusion() -> Iterator[Kind]:
    moving = _allow(0.15, 0.02, f"moved by 0.078; {_MOTION}")
    alone = _allow(0.5, 0.05, f"moved by 0.27; {_MOTION}")
    for prefix, whose in (("fusion", "the fusion filter's"), ("fusion.{source}", "this source's own")):
        for quantity, meaning in (
            ("heading.max", f"Largest error of {whose} heading during the motion"),
            ("heading.rms", f"rms error of {whose} heading during the motion"),
            ("tilt.rms", f"rms error of {whose} tilt during the motion"),
        ):
            subjects = {"accelerometer_magnetometer": alone} if quantity == "heading.max" else {}
            rms = f"{prefix}.heading.rms" if quantity == "heading.max" else ""
            yield Kind(f"{prefix}.{quantity}", "deg", _LOWER, moving, Section.FUSION, meaning, subjects, decided_by=rms)
    yield Kind("fusion.left_out", "", _LOWER, _COUNTED, Section.FUSION, "Samples lost and corrections refused")
    yield Kind("fusion.corrections", "", _NEITHER, _COUNTED, Section.FUSION, "Corrections that the filter took")


def _driving() -> Iterator[Kind]:
    moving = _allow(0.15, 0.02, f"as fusion.heading.rms: {_MOTION}")
    largest = _allow(0.5, 0.05, f"as fusion.accelerometer_magnetometer.heading.max: {_MOTION}")
    at_records = _allow(0.2, 0.05, "seen at records 0.15 s apart")
    for quantity, unit, allowance, meaning in (
        ("quiet_rms", "deg", moving, "rms heading error before anything disturbs the field"),
        ("rms", "deg", moving, "rms heading error while anything disturbs the field"),
        ("max", "deg", largest, "Largest heading error while anything disturbs the field"),
        ("current_rms", "deg", moving, "rms heading error while a current disturbs the field"),
        ("passing_rms", "deg", moving, "rms heading error while a magnet passes"),
        ("cable_rms", "deg", moving, "rms heading error while a cable is out of its place"),
        (
            "recovery_time",
            "s",
            at_records,
            "Longest time from the end of a disturbance until the heading is right to 5 degrees",
        ),
        ("unsaid", "s", at_records, "Time for which a heading was answered that was wrong by more than 5 degrees"),
    ):
        yield Kind(f"driving.{{source}}.{quantity}", unit, _LOWER, allowance, Section.DRIVING, meaning)
    yield Kind(
        "driving.fusion.left_out",
        "",
        _NEITHER,
        _COUNTED,
        Section.DRIVING,
        "Corrections that the filter left out while the field was disturbed, its only report of it",
    )
    calibrated = _allow(0.1, 0.05, f"as heading.dpi.max: {_MOTION}")
    for quantity, unit, allowance, meaning in (
        (
            "calibrated_max",
            "deg",
            calibrated,
            "Largest heading error, undisturbed, of a calibration from points that were all disturbed",
        ),
        (
            "calibrated_error",
            "%",
            _allow(0.02, 0.02, f"as fit.dpi.standard_error: {_MOTION}"),
            "Error as the calibrator reports it: the residual of a fit, the fit error of a streaming calibrator",
        ),
        (
            "kept_max",
            "deg",
            calibrated,
            "Largest heading error, undisturbed, of a streaming calibrator that got disturbed points after good ones",
        ),
        (
            "recalibrated_after",
            "s",
            _allow(1, 0.05, "seen at the end of tumbles 7 s apart"),
            "Time of turning without a disturbance until a calibration from disturbed points is right to 2 degrees",
        ),
    ):
        yield Kind(f"driving.{{calibrator}}.{quantity}", unit, _LOWER, allowance, Section.DRIVING, meaning)


def _own_language() -> Iterator[Kind]:
    """Yield the kinds for firmware that speaks its own language."""
    waited = _allow(1, 0.05, "found in steps of a window, a second unless the rig says otherwise")
    converge = "Give the filter more time under [device]: converge_s, settle_s."
    hear = "List the lines and bytes that are not understood: hiltest listen."
    for name, unit, better, allowance, meaning, next_step in (
        ("settle_time", "s", _LOWER, waited, "Longest time until a heading at rest stood still", converge),
        (
            "unsettled",
            "",
            _LOWER,
            _COUNTED,
            "Known angles at which the heading still moved at the end of the wait",
            converge,
        ),
        (
            "calibrated_after",
            "s",
            _LOWER,
            waited,
            "Time of turning until the firmware said that it is calibrated",
            "Turn the board through more directions, or more slowly: tumbles, tumble_s under [device].",
        ),
        (
            "errors",
            "",
            _LOWER,
            _COUNTED,
            "Errors that the firmware reported",
            "Check the output before the errors in the wire trace.",
        ),
        (
            "unconfirmed",
            "",
            _LOWER,
            _COUNTED,
            "Headings from a serial line that no neighbour confirmed, and left out",
            hear,
        ),
        ("not_understood", "", _LOWER, _COUNTED, "Bytes or lines from the firmware that were not understood", hear),
    ):
        yield Kind(f"device.{name}", unit, better, allowance, Section.HEADING, meaning, next_step=next_step)
    per_call = _allow(1, 0.005, _PER_CALL_WHY)
    number = _allow(0, 0.02, "as often as the firmware has data and time")
    for name, unit, better, allowance, meaning in (
        ("calls", "", _NEITHER, number, "Calls of a function while the firmware ran"),
        ("least", "cycle", _LOWER, per_call, "Fewest cycles of a call, without interrupts"),
        ("median", "cycle", _LOWER, per_call, "Median cycles of a call, without interrupts"),
        ("most", "cycle", _LOWER, per_call, "Most cycles of a call, without interrupts"),
        ("share", "%", _LOWER, _allow(0.05, 0.01, _PER_CALL_WHY), "Share of the processor's time in the function"),
        ("interrupted", "", _NEITHER, number, "Calls that an interrupt entered"),
        ("solutions", "", _NEITHER, number, "Solutions of a function that works in slices"),
        ("solution_median", "cycle", _LOWER, per_call, "Median cycles of all slices of a solution"),
        ("solution_most", "cycle", _LOWER, per_call, "Most cycles of all slices of a solution"),
        ("slices", "", _NEITHER, number, "Most slices of a solution"),
        ("slice_most", "cycle", _LOWER, per_call, "Most cycles of a slice"),
    ):
        cost = unit == "cycle"
        yield Kind(
            f"cycles.{{function}}.{name}",
            unit,
            better,
            allowance,
            Section.CYCLES,
            meaning,
            next_step=COSTS_TOO_MUCH if cost else "",
        )


def _board() -> Iterator[Kind]:
    for name, unit, better, meaning in (
        ("identity.calibrators", "", _NEITHER, "Calibrators that the firmware names"),
        ("identity.core_clock", "MHz", _NEITHER, "Core clock that the firmware reports"),
        ("link.echoed", "", _HIGHER, "Payloads that came back whole"),
        ("link.damaged_answered", "", _LOWER, "Damaged requests that were answered nevertheless"),
        ("link.damaged_uncounted", "", _LOWER, "Damaged requests that the firmware did not count"),
        ("link.retried", "", _LOWER, "Requests that had to be sent again"),
        ("link.uart_overruns", "", _LOWER, "Bytes that the board's UART lost"),
    ):
        yield Kind(name, unit, better, _COUNTED, Section.BOARD, meaning)
    for name, meaning in (
        ("flash", "Flash that the firmware takes"),
        ("ram", "RAM that the firmware takes before it runs: data, and code that is copied there"),
    ):
        yield Kind(f"firmware.{name}", "B", _LOWER, _allow(0, 0.01, _GROWTH), Section.BOARD, meaning)
    for name, whose in (
        ("stack_most", "the stack that the firmware starts with"),
        ("{task}.stack_most", "a task's stack, by the function that the task begins with"),
    ):
        yield Kind(
            f"firmware.{name}",
            "B",
            _LOWER,
            _allow(0, 0, _CALLED),
            Section.BOARD,
            f"Largest use of {whose}, including interrupts",
            compared=False,
        )
    yield Kind(
        "firmware.{function}.stack",
        "B",
        _LOWER,
        _allow(32, 0, _FRAME),
        Section.BOARD,
        "Largest stack of a call of a calibrator or another watched function, including its callees",
    )
    for name, meaning in (
        ("stack_bound", "Largest use of the initial stack on any path through the code"),
        ("{function}.stack_bound", "Largest stack of a call of that function on any path through the code"),
    ):
        yield Kind(f"firmware.{name}", "B", _LOWER, _allow(32, 0, _FRAME), Section.BOARD, meaning, compared=False)
    yield Kind(
        "board.virtual_seconds",
        "s",
        _NEITHER,
        _allow(5, 0.02, "waiting, not work; moved by 4.4 of 239"),
        Section.BOARD,
        "Time that passed on the virtual board",
        compared=False,
    )
    yield Kind("board.wall_seconds", "s", _NEITHER, _COUNTED, Section.BOARD, "Time that the run took", compared=False)


def _studies() -> Iterator[Kind]:
    for name, better, meaning in (
        ("ellipsoids.non_ellipsoids", _LOWER, "Instances of all noise levels whose quadric is no ellipsoid"),
        ("ellipsoids.instances", _NEITHER, "Instances of all noise levels"),
        ("ellipsoids.points", _NEITHER, "Points of each instance"),
        ("compensation.offset_reproduced", _NEITHER, "Figures of the thesis' Table 2 that came out"),
        ("compensation.sensitivity_reproduced", _NEITHER, "Figures of the thesis' Table 3 that came out"),
        ("compensation.points", _NEITHER, "Points of each instance"),
        ("constraints.clouds", _NEITHER, "Clouds of points whose best quadric is no ellipsoid"),
        ("constraints.fits", _NEITHER, "Constrained fits of them that are ellipsoids"),
        ("constraints.bettered", _NEITHER, "Of these, those with a better ellipsoid on the line to the best quadric"),
        ("constraints.determinant_fails", _NEITHER, "Clouds where the determinant is positive at both ends"),
        ("imu.li_differs", _NEITHER, "Instances for which li solves another problem once the mean is subtracted"),
    ):
        yield Kind(f"study.{name}", "", better, _COUNTED, Section.STUDIES, meaning)
    for angle in ("heading", "pitch", "roll"):
        yield Kind(
            f"study.dpi.{{calibration}}.{angle}",
            "deg",
            _LOWER,
            _COUNTED,
            Section.STUDIES,
            f"Median over instances of the largest error of {angle}",
        )
    yield Kind(
        "study.choose.{calibrator}.p95",
        "deg",
        _LOWER,
        _COUNTED,
        Section.STUDIES,
        "95th percentile over instances of the direction's rms error under the conditions asked about",
    )
    yield Kind(
        "study.choose.{calibrator}.cycles",
        "cycle",
        _LOWER,
        _COUNTED,
        Section.STUDIES,
        "Most cycles of one calibration on the virtual board over these instances",
        next_step=COSTS_TOO_MUCH,
    )
    yield Kind(
        "study.float32.{calibrator}.apart",
        "deg",
        _LOWER,
        _COUNTED,
        Section.STUDIES,
        "95th percentile over instances of the angle to float64, with hard iron of 10 times the field",
    )
    yield Kind(
        "study.imu.lstsq_rms",
        "g",
        _LOWER,
        _COUNTED,
        Section.STUDIES,
        "Median over instances of the rms that least squares leave on the six faces",
    )
    yield Kind(
        "study.imu.{calibrator}.without_fit",
        "%",
        _LOWER,
        _COUNTED,
        Section.STUDIES,
        "Share of instances without a fit, with an offset as large as the field",
    )
    yield Kind(
        "study.imu.{calibrator}.rms_less_mean",
        "",
        _LOWER,
        _COUNTED,
        Section.STUDIES,
        "Median over instances of the rms of norms about 1 by a fit of the points less their mean",
    )
    yield Kind(
        "study.budget.{calibrator}.mean_error",
        "deg",
        _LOWER,
        _COUNTED,
        Section.STUDIES,
        "Mean over instances of the direction's rms error with all effort",
    )
    yield Kind(
        "study.budget.{calibrator}.mean_cycles",
        "cycle",
        _LOWER,
        _COUNTED,
        Section.STUDIES,
        "Mean over instances of the clock cycles of all effort",
        next_step=COSTS_TOO_MUCH,
    )
    for quantile, named in (("median", "Median"), ("p95", "95th percentile")):
        yield Kind(
            f"study.estimators.{{calibrator}}.{quantile}",
            "deg",
            _LOWER,
            _COUNTED,
            Section.STUDIES,
            f"{named} of the direction's rms error over instances with 2.5 uT of noise and 1000 points",
        )


KINDS: Mapping[str, Kind] = {kind.name: kind for kind in _kinds()}
"""Every kind, by name."""

_SUBJECT = "{}"
# The name of a calibrator, of one of its further calibrations (direct@100), of an axis, a source or a function.
_SUBJECT_NAME = re.compile(r"[A-Za-z0-9_-]+(?:@[0-9]+)?")


def _form(name: str) -> tuple[str, ...]:
    """Return the parts of a kind's name, with the subject's place marked."""
    return tuple(_SUBJECT if part.startswith("{") else part for part in name.split("."))


_BY_FORM = {_form(name): kind for name, kind in KINDS.items()}


@cache
def identify(name: str) -> NamedKind:
    """Return kind and subject of a measurement's name; no other function splits names.

    A kind without a subject takes precedence: ``cycles.fusion.predict`` belongs to no calibrator.
    """
    parts = name.split(".")
    for marked in sorted(product((False, True), repeat=len(parts)), key=sum)[: len(parts) + 1]:
        form = tuple(_SUBJECT if is_subject else part for part, is_subject in zip(parts, marked, strict=True))
        subject = "".join(part for part, is_subject in zip(parts, marked, strict=True) if is_subject)
        if (kind := _BY_FORM.get(form)) is not None and (not subject or _SUBJECT_NAME.fullmatch(subject)):
            return NamedKind(kind, subject)
    return NamedKind(None)


def nearest_name(name: str, at_most: int = 2) -> str | None:
    """Return the known name within a few letters of `name`, with the subject of `name`."""
    if "*" in name:
        name = name.replace("*", "direct")  # the name is a pattern, and each limit belongs to one measurement
    parts = name.split(".")
    candidates = (
        ".".join(subject_part if part == _SUBJECT else part for part, subject_part in zip(form, parts, strict=True))
        for form in _BY_FORM
        if len(form) == len(parts)
    )
    near = sorted(
        (distance, candidate) for candidate in candidates if (distance := _edit_distance(name, candidate)) <= at_most
    )
    return near[0][1] if near else None


def _edit_distance(one: str, other: str) -> int:
    """Return the number of letters to insert, delete or replace (Levenshtein distance)."""
    row = list(range(len(other) + 1))
    for number, letter in enumerate(one, start=1):
        before, row[0] = row[0], number
        for place, against in enumerate(other, start=1):
            before, row[place] = row[place], min(row[place] + 1, row[place - 1] + 1, before + (letter != against))
    return row[-1]


def better_of(name: str, limit: Limit | None, unit: str = "") -> Better:
    """Return the better direction; for a user's own measurement fewer cycles are better, else its limit decides."""
    if (better := identify(name).better) is not None:
        return better
    if unit == "cycle":
        return Better.LOWER
    return limit.better if limit else Better.NEITHER


def tolerance_of(name: str, of_rig: Mapping[str, Tolerance]) -> Tolerance:
    """Return the tolerance of a measurement: the rig's, or else the kind's; exact for a user's own."""
    if (stated := of_rig.get(name)) is not None:
        return stated
    allowance = identify(name).allowance
    return allowance.tolerance if allowance else EXACT


def deviation_of(name: str) -> Deviation | None:
    """Return the deviation of a measurement between runs on the default rig that differ only in their noise.

    For a subject that the packaged firmware does not have, such as a calibrator of the user's own, it is the largest of
    its kind. The result is None if nothing differs, and for a user's own measurement.
    """
    kind = identify(name).kind
    deviation = DEVIATIONS.get(name) or (_largest_deviations().get(kind.name) if kind else None)
    return deviation if deviation and deviation.value else None


@cache
def _largest_deviations() -> Mapping[str, Deviation]:
    by_kind: dict[str, Deviation] = {}
    for name, deviation in sorted(DEVIATIONS.items(), key=lambda entry: entry[1].value):
        if (kind := identify(name).kind) is not None:
            by_kind[kind.name] = deviation
    return by_kind


def is_compared(name: str) -> bool:
    """Return whether comparisons include a measurement."""
    kind = identify(name).kind
    return kind is None or kind.compared


def is_direction(name: str) -> bool:
    """Return whether a measurement is a direction [deg]: 330 and 30 are 60 apart, and ratios have no meaning."""
    kind = identify(name).kind
    return kind is not None and kind.direction
