"""Calibrators over recorded samples: the calibration of each, and whether it may be used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from hiltest.calibration import FASTER, FIRMWARE, FOR_COMPARISON, REFERENCES, reference
from hiltest.calibration.acceptance import Acceptance
from hiltest.calibration.direct import fit_direct
from hiltest.calibration.fit import Array, FitStatus, MagnetometerFit
from hiltest.calibration.own import FileCalibrator, own_calibrator
from hiltest.calibration.quality import direction_difference_rms_deg
from hiltest.calibration.shapes import Shape, allowed_shape
from hiltest.calibration.solid_angle import largest_hole
from hiltest.errors import ConfigError, nearest_hint
from hiltest.log_fitting.counts import CountScale, evenly_on_sphere
from hiltest.log_fitting.fit_notes import notes
from hiltest.log_fitting.fit_result import AgainstGravity, CalibratorFit, FirmwareUsed, SampleFit, best_of
from hiltest.log_fitting.gravity_fit import against_gravity
from hiltest.log_fitting.left_out import left_out
from hiltest.log_fitting.rating import Rating, triple
from hiltest.log_fitting.samples import Samples
from hiltest.log_fitting.span import field_change, field_growth, is_at_rest, is_in_order_of_time

if TYPE_CHECKING:
    from hiltest.boards.board import Board

#: Selections instead of one calibrator's name: those of the board, and also all with a reference.
BOARD, ALL = "board", "all"
Selected: TypeAlias = str | FileCalibrator
# Refusals that apply to any shape.
_OF_ANY_SHAPE = {"residual_of_spread", "halves_difference"}


def fit_on_host(
    samples: Samples,
    *calibrators: Selected,
    robust: bool = True,
    any_shape: bool = True,
    field_ut: float | None = None,
) -> SampleFit:
    """Run the float64 references over all samples.

    Parameters
    ----------
    *calibrators
        Names and calibrators in files, `BOARD` (by default) or `ALL`.
    robust
        True to omit the readings of `hiltest.log_fitting.left_out.left_out`.
    any_shape
        True to fit the shape that the samples allow if all calibrators are refused.
    field_ut
        Strength of the field, if it is known.

    Raises
    ------
    ConfigError
        When a calibrator has no reference, or the field is given and the unit of the samples is unknown.
    """
    of_groups = {BOARD: FIRMWARE - FASTER - FOR_COMPARISON, ALL: REFERENCES.keys() - FASTER}
    several = bool({BOARD, ALL}.intersection(calibrators or (BOARD,)))
    log = _Log(samples, robust, field_ut)
    fits = [log.fit_on_host(one) for one in _expand(calibrators, {name: sorted(of_groups[name]) for name in of_groups})]
    return log.fit("host", None, log.add_shape(fits) if any_shape and several else fits, fit_gravity=several)


def _expand(calibrators: Sequence[Selected], of_groups: Mapping[str, Sequence[str]]) -> list[Selected]:
    """Return the calibrators with the members of groups in their place, each of them once."""
    groups = (of_groups.get(one, [one]) if isinstance(one, str) else [one] for one in calibrators or (BOARD,))
    return list(dict.fromkeys(chain.from_iterable(groups)))


def fit_by_shape(samples: Samples, shape: Shape, *, robust: bool = True, field_ut: float | None = None) -> SampleFit:
    """Fit one shape to all samples; see `fit_on_host`. In a plane `field_ut` is the strength of the part in it."""
    log = _Log(samples, robust, field_ut)
    return log.fit("host", None, [log.shape(shape, log.field)])


def fit_on_board(
    board: Board,
    samples: Samples,
    *calibrators: Selected,
    robust: bool = True,
    any_shape: bool = True,
    field_ut: float | None = None,
) -> SampleFit:
    """Run a board's calibrators over its capacity of samples, chosen evenly on the sphere.

    Parameters
    ----------
    board
        Board whose point buffer is replaced.
    *calibrators
        Names as in the board's identity, `BOARD` (by default), or `ALL`, which adds the references of calibrators that
        the board lacks; those of installed packages and in files run on the host.
    robust, any_shape, field_ut
        See `fit_on_host`; a shape is fitted on the host.

    Returns
    -------
    SampleFit
        Result with figures over all samples that are not omitted, so that a verdict applies to the whole file; only the
        predicted direction error is that of the calibrator's points.

    Raises
    ------
    ConfigError
        When the firmware has no such calibrator.
    """
    from hiltest.procedures.calibrate import calibrate_once  # takes 0.1 s, which a fit on the host does not need
    from hiltest.procedures.cycles import upload_points

    in_board = board.identity.calibrators
    several = bool({BOARD, ALL}.intersection(calibrators or (BOARD,)))
    of_groups = {
        BOARD: [name for name in in_board if name not in FOR_COMPARISON],
        ALL: [*in_board, *sorted(REFERENCES.keys() - FASTER - set(in_board))],
    }
    selected = _expand(calibrators, of_groups)
    for name in calibrators:
        if isinstance(name, str) and name not in (*of_groups, *in_board) and own_calibrator(name) is None:
            raise ConfigError(
                f"the firmware has no calibrator {name!r}; it has {', '.join(in_board)}; "
                + (
                    f"--on host runs the reference {name}"
                    if name in REFERENCES
                    else nearest_hint(name, [*in_board, *REFERENCES])
                )
            )
    log = _Log(samples, robust, field_ut)
    scale, used = log.scale, log.choose_evenly(board.identity.max_points)
    upload_points(board, scale.counts(used))
    fits = []
    for name in selected:
        if not isinstance(name, str) or name not in in_board:
            fits.append(log.fit_on_host(name))
            continue
        fit, cost = calibrate_once(board, name, len(used))
        result = log.rating.calibrator(name, scale.convert_fit(fit), used)
        whole = REFERENCES[name](log.counts) if name in REFERENCES else None
        band = board.cycle_range(cost, name)
        fits.append(
            replace(
                result,
                cycles=cost.cycles if cost else None,
                cycle_band=band,
                host_difference_deg=_difference_deg(fit, whole),
            )
        )
    rounding = scale.counts(used) / scale.per_unit + scale.origin - used
    firmware = FirmwareUsed(
        name=board.identity.name,
        version=board.identity.version,
        build_id=board.identity.build_id,
        sha256=board.firmware_sha256,
        cycle_model=board.cycle_model,
        count_step=scale.step,
        count_origin=triple(scale.origin),
        rounding_rms=float(np.sqrt((rounding * rounding).mean())),
    )
    return log.fit(
        str(board.kind), firmware, log.add_shape(fits) if any_shape and several else fits, fit_gravity=several
    )


class _Log:
    """A log during its fit: the remaining samples, and the rating of calibrations."""

    def __init__(self, samples: Samples, robust: bool, field_ut: float | None) -> None:
        if field_ut is not None and samples.microtesla is None:
            raise ConfigError(f"{samples.path}: a field in uT cannot be compared with counts; set their unit (--unit)")
        self._samples, self._field_ut = samples, field_ut
        self._gone = left_out(samples, robust=robust)
        self._robust, self.kept = robust, self._gone.rest
        self._growth = field_growth(samples)
        # A growth looks like a step of some hard iron as well.
        self._change = field_change(samples) if self._growth is None else None
        self.rating = Rating(self.kept, self._change, self._growth)
        self.scale = CountScale.choose(self.kept)
        self.counts = self.scale.unrounded(self.kept.points)

    @property
    def field(self) -> float | None:
        """Strength of the field in the unit of the samples; None if it is not known."""
        microtesla = self._samples.microtesla
        return None if self._field_ut is None or microtesla is None else self._field_ut / microtesla

    def fit_on_host(self, calibrator: Selected) -> CalibratorFit:
        """Fit a reference, or the calibrator of a package or a file, to the log in counts, and rate it."""
        if isinstance(calibrator, str):
            name, fit, used = calibrator, reference(calibrator)(self.counts), self.kept.points
        else:
            used = self.choose_evenly(calibrator.most_points or len(self.counts))
            name, (fit, _) = calibrator.name, calibrator.calibrate(self.scale.unrounded(used))
        return self.rating.calibrator(name, self.scale.convert_fit(fit), used)

    def choose_evenly(self, most: int) -> Array:
        """Return at most this many points of the log, chosen evenly on the sphere."""
        points = self.kept.points
        if len(points) <= most:
            return points
        about = fit_direct(self.counts)
        centre = self.scale.convert_fit(about).hard_iron if about.has_fit else points.mean(axis=0)
        return points[evenly_on_sphere(points, most, centre)]

    def shape(self, shape: Shape, field: float | None) -> CalibratorFit:
        """Fit a shape to the log, and rate it."""
        return self.rating.shape(shape, field, self._gone.dropped_percent)

    def add_shape(self, fits: Sequence[CalibratorFit]) -> Sequence[CalibratorFit]:
        """Add the fit of the allowed shape if all fits are refused for reasons that a shape avoids, and it is not."""
        best = best_of(fits)
        refusals = {reason.figure for reason in best.reasons if reason.verdict is Acceptance.REFUSED}
        if not refusals or refusals & _OF_ANY_SHAPE:
            return fits
        shape = allowed_shape(self.kept.points)
        # The field's component in the plane of a turn is unknown.
        rated = self.shape(shape, self.field if shape.axes == 3 else None)
        return fits if rated.verdict is Acceptance.REFUSED else [*fits, rated]

    def fit(
        self, on: str, firmware: FirmwareUsed | None, fits: Sequence[CalibratorFit], *, fit_gravity: bool = False
    ) -> SampleFit:
        """Return the result, compared with gravity if not all fits are refused, and fitted to it if requested."""
        samples, gone, best = self._samples, self._gone, best_of(fits)
        log: AgainstGravity | None = None
        against: list[CalibratorFit] = []
        if best.verdict is not Acceptance.REFUSED and best.shape is None:
            log, against = against_gravity(self.kept, self.rating, robust=self._robust, fit=fit_gravity)
        hole = None
        if best.hard_iron is not None and best.soft_iron is not None and best.turn is None:
            hole = largest_hole((self.kept.points - best.hard_iron) @ np.array(best.soft_iron))
        fit = SampleFit(
            file=str(samples.path),
            columns=samples.columns,
            unit=str(samples.unit),
            unit_from=samples.unit_from,
            n_in=len(samples.points),
            n_skipped=samples.skipped,
            n_repeated=int(gone.repeated.sum()),
            robust="tukey" if gone.robust else "none",
            n_dropped=gone.n_dropped,
            dropped=gone.dropped_lines,
            in_order=is_in_order_of_time(self.kept),
            at_rest=is_at_rest(self.kept),
            change=self._change,
            growth_percent=self._growth,
            condition=self.rating.condition,
            hole=hole,
            field_ut=self._field_ut,
            on=on,
            firmware=firmware,
            calibrators=(*fits, *against),
            notes=(),
            as_read=self.rating.as_read(best),
            gravity=log,
            ellipsoid=self.rating.ellipsoid if any(fit.error_is_measured for fit in fits) else None,
        )
        return replace(fit, notes=(*self._samples.notes, *notes(fit)))


def _difference_deg(fit: MagnetometerFit, whole: MagnetometerFit | None) -> float | None:
    """Return the angle between a board's calibration and that of all samples; None if one is not an ellipsoid."""
    if whole is None or {fit.status, whole.status} != {FitStatus.ELLIPSOID}:
        return None
    return direction_difference_rms_deg(fit, whole)
