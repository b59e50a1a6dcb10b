"""The firmware's answers against the samples that the sensors delivered: the first link from sensor to heading.

A virtual board sees every sample on its I2C bus. Means, points, sums, times and temperatures that the firmware answers
follow from these samples alone. If they differ, the firmware is at fault, even if its headings agree with each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import permutations, product
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from hiltest.errors import FirmwareContradictionError
from hiltest.link.accelerometer import SetAccelerometer
from hiltest.link.fusion import FusionRead, FusionRecords, FusionRun, FusionStart, FusionSummary
from hiltest.link.gyroscope import (
    EDGE_SAMPLES,
    GyroscopeRest,
    GyroscopeRestReply,
    IntegrateGyroscopeReply,
    LogGyroscopeReply,
    SetGyroscope,
    Span,
    StillnessKind,
)
from hiltest.link.messages import (
    ClearCalibration,
    ClearPoints,
    Collect,
    Points,
    Read,
    Reset,
    Select,
    SetCalibration,
    Upload,
)
from hiltest.link.poses import AddPoseReply
from hiltest.link.replies import (
    DPS_PER_COUNT,
    G_PER_COUNT,
    AverageReply,
    PointsReply,
    ReadReply,
    SensorInfo,
    SensorKind,
    Statistic,
)
from hiltest.link.request import Request
from hiltest.orientation import DegenerateFieldError
from hiltest.orientation.attitude_filter import AttitudeFilter, AttitudeFilterSettings, AttitudeFilterStatus
from hiltest.orientation.quaternions import Quaternion
from hiltest.orientation.triad import triad
from hiltest.text import format_count

_FLOAT32_ROUNDING = 2.0**-24  # relative; a sum of n float32 has at most n - 1 of them, and the division one
_SPREAD_SHARE, _SPREAD_COUNTS = 1e-3, 0.01  # rounding of a standard deviation that is computed in float32
_LOOK_S = 0.5e-3  # from a look at the clock to the transfer of status and sample, and from there to the next look
_SPAN_PERIODS = 1.0 / 8.0  # PROTOCOL.md: a span's times are known to a sixteenth of a period; as much for the transfer
# sampler.c: the firmware looks eight times a period, so that it knows the first instants to a sixteenth at either side.
_PAIRING_PERIODS = 1.0 / 16.0
_PAIRING_COUNTS = 1.5  # rounding to whole counts of two readings and of the line between them
# An attitude's rounding to 1/32767 is 6e-5 at most [rad]. Ten roundings in float32 are 1.2e-6 as an angle, and the sine
# between gravity and field divides them. The filter's roundings add up to 5e-5
# (tests/firmware/test_attitude_filter.py), and the times of its rates are known to a look.
_ATTITUDE_RAD, _FLOAT32_RAD, _FILTER_RAD = 1e-4, 2e-6, 2e-4
_CHANGES_POINTS = frozenset({Collect.code, Upload.code, ClearPoints.code, Reset.code})
_FUSED = (SensorKind.GYROSCOPE, SensorKind.MAGNETOMETER)
_CHANGES_RECORDS = frozenset({FusionStart.code, FusionRun.code, Reset.code})

Counts = NDArray[np.int64]
Reals = NDArray[np.float64]

_NOMINAL = {
    kind: (unit * np.eye(3), np.zeros(3))
    for kind, unit in zip(SensorKind, (math.nan, G_PER_COUNT, DPS_PER_COUNT), strict=True)
}
"""Calibrations after a reset, PROTOCOL.md; the magnetometer has none."""


class Samples(NamedTuple):
    """Samples that a sensor delivered, in order."""

    counts: Counts
    """Shape (n, 3). Body frame."""
    number: Counts
    """Shape (n,). Number of each sample at the part's rate."""
    instant_s: Reals
    """Shape (n,). Sampling instants, virtual time."""
    time_s: Reals
    """Shape (n,). Times of the transfers."""
    period_s: float

    def since(self, time_s: float) -> Samples:
        """Return the samples that were taken at a time or later."""
        return self.select(self.instant_s >= time_s)

    def select(self, places: slice | NDArray[np.bool_]) -> Samples:
        """Return the samples at some places."""
        return Samples(
            self.counts[places], self.number[places], self.instant_s[places], self.time_s[places], self.period_s
        )


@dataclass(slots=True)
class _CollectedPoints:
    """Points of one COLLECT: their places in the buffer, and the samples that they must come from."""

    first: int
    end: int
    magnetometer: Samples
    accelerometer: Samples
    next_sample: int = 0
    read_back: dict[int, Counts] = field(default_factory=dict)
    """Points that were read before, as magnetometer and accelerometer counts."""


class _FusionBegin(NamedTuple):
    """First measurement of a filter."""

    request: FusionStart
    gravity_g: Reals
    field: Reals
    rest_s: float
    """Time of the samples that they are means of."""

    def filter(self, settings: AttitudeFilterSettings) -> AttitudeFilter:
        """Return the filter after this measurement."""
        attitude_filter = AttitudeFilter(np.zeros(3), settings)
        attitude_filter.turn((0.0, 0.0, 0.0), self.rest_s)
        attitude_filter.correct(self.gravity_g.tolist(), self.field.tolist())
        return attitude_filter


class _FusionRecords(NamedTuple):
    """Records of one FUSION_RUN, as they follow from the samples."""

    began_s: float
    samples: Samples
    """Samples of the magnetometer at the records."""
    attitudes: Reals
    """Shape (n, 3, 4). Attitudes of accelerometer and magnetometer, of the gyroscope, and of the filter."""
    measured_rad: Reals
    """Shape (n,). Tolerance of the first."""
    tolerance_rad: float
    """Tolerance of the last two; infinity if a step may be refused or not."""


class DeliveredSamples:
    """Checks of replies against the samples that the sensors delivered since the request.

    Parameters
    ----------
    sensors
        Sensors that the firmware knows.
    samples
        Returns the samples that a sensor has delivered since the request.
    temperature
        Returns the byte of a part's temperature register that was transferred last since the request; None if none was.
    board_us
        Returns the virtual time of a time of the firmware's clock [us].
    """

    def __init__(
        self,
        sensors: Sequence[SensorInfo],
        samples: Callable[[SensorInfo], Samples],
        temperature: Callable[[SensorInfo], int | None],
        board_us: Callable[[int], float],
    ) -> None:
        self._sensors = sensors
        self._samples, self._temperature, self._virtual_s = samples, temperature, board_us
        self._selected = {sensor.kind: sensor for sensor in reversed(sensors) if sensor.selected}
        self._begin_s = 0.0
        self._stored: int | None = None  # points in the buffer; None if unknown
        self._stored_before: int | None = None
        self._collected: list[_CollectedPoints] = []
        self._fusion_begin: _FusionBegin | None = None
        self._fusion: _FusionRecords | None = None
        # Matrix and offset by kind and slot; the gyroscope's has no slot.
        self._calibrations: dict[tuple[SensorKind, int], tuple[ArrayLike, ArrayLike]] = {}

    def begin(self, code: int, time_s: float) -> None:
        """Note that a request is sent."""
        self._begin_s = time_s
        if code in _CHANGES_POINTS:
            self._stored_before, self._stored = self._stored, None
        if code in _CHANGES_RECORDS:
            self._fusion = None

    def check(self, request: Request[Any], reply: object) -> None:
        """Check a reply.

        Raises
        ------
        FirmwareContradictionError
            When it does not follow from the samples.
        """
        self._follow(request)
        if isinstance(reply, AverageReply):
            self._check_average(reply)
        elif isinstance(reply, AddPoseReply):
            self._check_average(reply.average)
            self._check_temperature(self._selected[SensorKind.ACCELEROMETER], reply.die_temperature_degc)
        elif isinstance(request, Read) and isinstance(reply, ReadReply):
            self._check_read(self._sensors[request.sensor_id], reply)
        elif isinstance(request, Points) and isinstance(reply, PointsReply):
            self._check_points(request.first, reply)
        elif isinstance(reply, GyroscopeRestReply | IntegrateGyroscopeReply | LogGyroscopeReply):
            self._check_gyroscope(reply)
        elif isinstance(request, FusionStart) and isinstance(reply, np.ndarray):
            self._check_first_attitude(request, reply)
        elif isinstance(reply, FusionSummary):
            self._follow_fusion(reply)
        elif isinstance(request, FusionRead) and isinstance(reply, FusionRecords):
            self._check_records(request.first, reply)
        self._follow_calibrations(request, reply)

    def _follow(self, request: Request[Any]) -> None:
        """Follow the state of the firmware: the selected sensors and the buffer of points."""
        if isinstance(request, Select):
            sensor = self._sensors[request.sensor_id]
            self._selected[sensor.kind] = sensor
        elif isinstance(request, Reset):
            self._stored, self._collected = 0, []
            self._selected = {sensor.kind: sensor for sensor in reversed(self._sensors) if sensor.present}
        elif isinstance(request, ClearPoints):
            self._stored, self._collected = 0, []
        elif isinstance(request, Upload) and self._stored_before is not None:
            self._stored = self._stored_before + len(request.points)
        elif isinstance(request, Collect) and self._stored_before is not None:
            self._stored = self._stored_before + request.count
            fresh = self._fresh(SensorKind.MAGNETOMETER)
            pairs = self._samples(self._selected[SensorKind.ACCELEROMETER])
            self._collected.append(_CollectedPoints(self._stored_before, self._stored, fresh, pairs))

    def _follow_calibrations(self, request: Request[Any], reply: object) -> None:
        if isinstance(request, SetCalibration):
            self._calibrations[SensorKind.MAGNETOMETER, request.slot] = request.soft_iron, request.hard_iron
        elif isinstance(request, SetAccelerometer):
            self._calibrations[SensorKind.ACCELEROMETER, request.slot] = request.gain, request.offset
        elif isinstance(request, ClearCalibration):
            for kind in (SensorKind.MAGNETOMETER, SensorKind.ACCELEROMETER):
                self._calibrations.pop((kind, request.slot), None)
        elif isinstance(request, SetGyroscope):
            self._calibrations[SensorKind.GYROSCOPE, 0] = request.matrix, request.bias
        elif isinstance(request, GyroscopeRest) and isinstance(reply, GyroscopeRestReply):
            if request.store and reply.stillness.kind in (StillnessKind.STILL, StillnessKind.NOT_TESTED):
                matrix, _ = self._calibrations.get((SensorKind.GYROSCOPE, 0), _NOMINAL[SensorKind.GYROSCOPE])
                self._calibrations[SensorKind.GYROSCOPE, 0] = matrix, reply.rate.mean
        elif isinstance(request, Reset):
            self._calibrations = {}

    def _calibrated(self, kind: SensorKind, slot: int, counts: Counts | Reals) -> Reals:
        """Return counts under a calibration."""
        matrix, offset = self._calibrations.get((kind, slot), _NOMINAL[kind])
        return np.asarray((counts - np.asarray(offset)) @ np.reshape(matrix, (3, 3)).T)

    def _fresh(self, kind: SensorKind) -> Samples:
        return self._samples(self._selected[kind]).since(self._begin_s)

    def _check_average(self, reply: AverageReply) -> None:
        self._check_statistic(SensorKind.MAGNETOMETER, reply.n, reply.magnetometer)
        self._check_statistic(SensorKind.ACCELEROMETER, reply.n, reply.accelerometer)

    def _check_statistic(self, kind: SensorKind, n: int, statistic: Statistic) -> tuple[Samples, int]:
        """Check mean and spread of n samples; return the samples and the place of the first one."""
        sensor, samples = self._selected[kind], self._fresh(kind)
        places = _places_of_mean(samples, n, statistic.mean)
        if not len(places):
            self._raise_mean_fault(sensor, n, statistic.mean)
        if statistic.spread is not None:
            spreads = np.array([np.std(samples.counts[place : place + n], axis=0, ddof=1) for place in places])
            error = np.abs(spreads - statistic.spread)
            exact = np.all(error <= _SPREAD_SHARE * spreads + _SPREAD_COUNTS, axis=1)
            if not exact.any():
                axis = int(error[0].argmax())
                _raise(
                    f"{_series(sensor, n, 'spread')} is not that of the samples that the sensor delivered "
                    f"({'xyz'[axis]}: {statistic.spread[axis]:.4g} counts, not {spreads[0][axis]:.4g})"
                )
        return samples, int(places[-1])

    def _raise_mean_fault(self, sensor: SensorInfo, n: int, mean: Reals) -> NoReturn:
        series, samples = _series(sensor, n, "mean"), self._samples(sensor)
        fresh = samples.since(self._begin_s)
        if len(places := _places_of_mean(samples, n, mean)):
            early_ms = 1e3 * (self._begin_s - samples.instant_s[places[-1]])
            _raise(f"{series} includes a sample that the part took {early_ms:.1f} ms before the request")
        if len(fresh.number) < n:
            _raise(f"{series} is answered, but the sensor delivered {len(fresh.number)} samples")
        if len(_places_of_mean(fresh, n, mean, distinct=False)):
            _raise(f"{series} counts a sample more than once: the firmware reads before there is a new one")
        delivered = fresh.counts[-n:].mean(axis=0)
        if axes := _exchanged_axes(delivered, mean, _tolerance(n, fresh.counts)):
            _raise(f"{series} has {axes} in place of (x, y, z) of the samples that the sensor delivered")
        _raise(f"{series} is not the mean of the samples that the sensor delivered ({_difference(mean - delivered)})")

    def _check_temperature(self, sensor: SensorInfo, answered_degc: int) -> None:
        byte = self._temperature(sensor)
        if byte is None:
            _raise(f"the firmware answers {answered_degc} degC, and has not read the temperature of {sensor.name}")
        if answered_degc != (byte ^ 0x80) - 0x80:
            _raise(f"the firmware answers {answered_degc} degC, and {sensor.name} delivered {(byte ^ 0x80) - 0x80}")

    def _check_read(self, sensor: SensorInfo, reply: ReadReply) -> None:
        samples = self._samples(sensor)
        fresh = samples.since(self._begin_s)
        place = self._place_of_sequence(sensor, fresh, samples, reply.counts)
        used = fresh.select(slice(place, place + len(reply.counts)))
        self._check_times(sensor, used, np.array([self._virtual_s(time_us) for time_us in reply.time_us.tolist()]))
        self._check_temperature(sensor, reply.die_temperature_degc)

    def _check_times(self, sensor: SensorInfo, samples: Samples, times_s: Reals) -> None:
        """Check the times of samples by the firmware's clock: between the sampling instant and the transfer."""
        rows = zip(times_s.tolist(), samples.instant_s.tolist(), samples.time_s.tolist(), strict=True)
        for index, (time_s, instant_s, read_s) in enumerate(rows):
            if time_s < instant_s - _LOOK_S:
                _raise(
                    f"the firmware's time of {sensor.name} sample {index} is {1e3 * (instant_s - time_s):.2f} ms "
                    "before the part took it"
                )
            if time_s > read_s + _LOOK_S:
                _raise(
                    f"the firmware's time of {sensor.name} sample {index} is {1e3 * (time_s - read_s):.2f} ms after it "
                    "was read"
                )

    def _place_of_sequence(self, sensor: SensorInfo, fresh: Samples, samples: Samples, answered: ArrayLike) -> int:
        """Return the place of answered samples in those that were delivered, or raise the difference."""
        counts = np.asarray(answered, dtype=np.int64)
        n = len(counts)
        if not n:
            return 0
        if len(places := _places_of_sequence(fresh.counts, counts)):
            return int(places[-1])
        whose = f"the firmware's {format_count(n, 'sample')} of {sensor.name}"
        if len(_places_of_sequence(samples.counts, counts)):
            _raise(f"{whose} begin with one that the part took before the request")
        if len(_places_of_sequence(fresh.counts, counts[::-1])):
            _raise(f"{whose} are in reverse order")
        if len(fresh.counts) < n:
            _raise(f"{whose} are not all its own: the sensor delivered {len(fresh.counts)}")
        delivered = fresh.counts[-n:]
        if sorted(map(tuple, counts.tolist())) == sorted(map(tuple, delivered.tolist())):
            _raise(f"{whose} are in another order than the sensor delivered them")
        if axes := _exchanged_axes(delivered, counts, 0.0):
            _raise(f"{whose} have {axes} in place of (x, y, z)")
        index = int(np.any(counts != delivered, axis=1).argmax())
        difference = _difference(counts[index] - delivered[index])
        _raise(f"{whose} are not those that the sensor delivered (sample {index}, {difference})")

    def _check_points(self, first: int, reply: PointsReply) -> None:
        if self._stored is None:
            return
        rows = np.hstack([reply.magnetometer, reply.accelerometer]).astype(np.int64)
        for index, row in enumerate(rows, first):
            for group in self._collected:
                if group.first <= index < group.end:
                    self._check_point(index, row, group)

    def _check_point(self, index: int, row: Counts, group: _CollectedPoints) -> None:
        if index in group.read_back:
            if not np.array_equal(row, group.read_back[index]):
                _raise(f"the firmware's point {index} has changed since it was read")
            return
        sensor, samples = self._selected[SensorKind.MAGNETOMETER], group.magnetometer
        equal = np.flatnonzero(np.all(samples.counts[group.next_sample :] == row[:3], axis=1))
        if not len(equal):
            expected = samples.counts[group.next_sample :][:1]
            if not len(expected):
                _raise(f"the firmware has a point {index}, and {sensor.name} delivered no sample for it")
            if axes := _exchanged_axes(expected[0], row[:3], 0.0):
                _raise(f"the firmware's point {index} has {axes} in place of (x, y, z) of {sensor.name}'s sample")
            _raise(
                f"the firmware's point {index} is not the next sample that {sensor.name} delivered "
                f"({_difference(row[:3] - expected[0])})"
            )
        # Equal readings may follow each other: the point is one of them, the first whose acceleration fits.
        outside = [_outside_line(group, row[3:], group.next_sample + int(place)) for place in equal]
        fits = [not difference.any() for difference in outside]
        if not any(fits):
            _raise(
                f"the firmware's acceleration of point {index} is not the line between the accelerometer's samples "
                f"before and after it ({_difference(outside[0])} at least)"
            )
        place = group.next_sample + int(equal[fits.index(True)])
        group.next_sample, group.read_back[index] = place + 1, row

    def _check_gyroscope(self, reply: GyroscopeRestReply | IntegrateGyroscopeReply | LogGyroscopeReply) -> None:
        sensor = self._selected[SensorKind.GYROSCOPE]
        if isinstance(reply, GyroscopeRestReply):
            n = reply.n
            samples, place = self._check_statistic(SensorKind.GYROSCOPE, n, reply.rate)
        elif isinstance(reply, LogGyroscopeReply):
            # The part's FIFO keeps samples from before the request, which asks for these.
            n, samples = len(reply.samples), self._samples(sensor)
            place = self._place_of_sequence(sensor, samples, samples, reply.samples)
        else:
            n = reply.n
            samples, place = self._check_sums(sensor, reply)
        self._check_temperature(sensor, reply.die_temperature_degc)
        if n:
            self._check_span(
                sensor, samples, slice(place, place + n), reply.span, in_log=isinstance(reply, LogGyroscopeReply)
            )

    def _check_first_attitude(self, request: FusionStart, attitude: Quaternion) -> None:
        magnetometer = self._fresh(SensorKind.MAGNETOMETER).select(slice(-request.readings, None))
        if len(magnetometer.counts) < request.readings:
            samples = format_count(request.readings, "sample")
            _raise(f"the firmware's attitude is from {samples}, and the sensor delivered {len(magnetometer.counts)}")
        accelerations = self._latest_accelerations(np.append(magnetometer.time_s[1:], np.inf))
        gravity_g = self._calibrated(SensorKind.ACCELEROMETER, request.slot, accelerations.mean(axis=0))
        field = self._calibrated(SensorKind.MAGNETOMETER, request.slot, magnetometer.counts.mean(axis=0))
        _check_attitudes("first attitude", attitude[None], _triads(gravity_g[None], field[None]), _ATTITUDE_RAD)
        self._fusion_begin = _FusionBegin(request, gravity_g, field, request.readings * magnetometer.period_s)

    def _latest_accelerations(self, until_s: Reals) -> Counts:
        """Return the accelerometer's latest samples before the transfers of others' next samples."""
        accelerometer = self._samples(self._selected[SensorKind.ACCELEROMETER])
        latest = np.searchsorted(accelerometer.time_s, until_s) - 1
        if latest.min(initial=0) < 0:
            _raise("the firmware answers an attitude for which the accelerometer delivered no sample")
        return accelerometer.counts[latest]

    def _follow_fusion(self, summary: FusionSummary) -> None:
        if self._fusion_begin is None:
            return
        began_s = self._virtual_s(summary.began_us)
        gyroscope, magnetometer = (
            samples.select(samples.time_s > began_s)
            for samples in (self._samples(self._selected[kind]) for kind in _FUSED)
        )
        updates = len(magnetometer.counts)
        records = -(-updates // self._fusion_begin.request.every)
        for name, count, delivered in (
            ("update", summary.costs.updates, updates),
            ("record", summary.records, records),
        ):
            if count != delivered:
                _raise(f"the firmware answers {format_count(count, name)}, and the sensors' samples make {delivered}")
        self._fusion = self._fuse(self._fusion_begin, summary, gyroscope, magnetometer)

    def _fuse(
        self, begin: _FusionBegin, summary: FusionSummary, gyroscope: Samples, magnetometer: Samples
    ) -> _FusionRecords:
        """Run the filter with delivered samples."""
        began_s, slot = self._virtual_s(summary.began_us), begin.request.slot
        times_s = np.append(gyroscope.time_s, magnetometer.time_s)
        order = np.argsort(times_s, kind="stable")
        times_s, is_update = times_s[order], order >= len(gyroscope.counts)
        # A gyroscope's sample turns by the mean of its rate and the one before, a magnetometer's by the latest rate.
        rates_rad_s = np.radians(np.vstack([np.zeros(3), self._calibrated(SensorKind.GYROSCOPE, 0, gyroscope.counts)]))
        latest = np.cumsum(~is_update)
        before = np.where(is_update, latest, np.maximum(latest - 1, 1))
        steps_s = np.diff(times_s, prepend=began_s + 0.5 * _LOOK_S)
        means_rad_s = 0.5 * (rates_rad_s[latest] + rates_rad_s[before])
        accelerations = self._latest_accelerations(np.append(times_s[1:], np.inf)[is_update])
        gravity_g = self._calibrated(SensorKind.ACCELEROMETER, slot, accelerations)
        field = self._calibrated(SensorKind.MAGNETOMETER, slot, magnetometer.counts)
        tolerance_rad = _FILTER_RAD + _LOOK_S * float(np.linalg.norm(rates_rad_s, axis=1).max())

        def run(gate_change: float) -> tuple[Reals, list[AttitudeFilterStatus]]:
            """Return attitudes of gyroscope and filter, shape (2, n, 4), and the statuses of the filter's steps."""
            default = AttitudeFilterSettings()
            settings = replace(default, field_gate=max(0.0, default.field_gate + gate_change))
            turned, fused = begin.filter(settings), begin.filter(settings)
            attitudes, statuses = [], []
            readings = zip(gravity_g.tolist(), field.tolist(), strict=True)
            for rate_rad_s, step_s, updates in zip(means_rad_s.tolist(), steps_s, is_update, strict=True):
                turned.turn(rate_rad_s, step_s)
                if updates:
                    statuses.append(fused.update(rate_rad_s, *next(readings), step_s))
                    attitudes.append((turned.attitude, fused.attitude))
                else:
                    statuses.append(fused.turn(rate_rad_s, step_s))
            return np.array(attitudes).reshape(-1, 2, 4).swapaxes(0, 1), statuses

        # An attitude that errs by the tolerance moves the parts of the field, measured and expected, by as much of it.
        # Without a field that may be on either side of the gate, two gates make the same attitudes.
        (turned, fused), statuses = run(-2.0 * tolerance_rad)
        (_, other), _ = run(2.0 * tolerance_rad)
        largest_turn_rad = (np.linalg.norm(means_rad_s, axis=1) * steps_s).max(initial=0.0)
        if largest_turn_rad > math.pi - tolerance_rad or not np.array_equal(fused, other):
            tolerance_rad = math.inf
        else:
            for count, status in (
                (summary.no_attitude, AttitudeFilterStatus.NO_ATTITUDE),
                (summary.field_left_out, AttitudeFilterStatus.FIELD_LEFT_OUT),
            ):
                if count != statuses.count(status):
                    _raise(f"the firmware answers {count} updates with {status.name}, not {statuses.count(status)}")
        places = slice(None, None, begin.request.every)
        attitudes = np.stack([_triads(gravity_g, field), turned, fused], axis=1)[places]
        norms = np.linalg.norm(gravity_g, axis=1) * np.linalg.norm(field, axis=1)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            measured_rad = _ATTITUDE_RAD + _FLOAT32_RAD * norms / np.linalg.norm(np.cross(gravity_g, field), axis=1)
        return _FusionRecords(began_s, magnetometer.select(places), attitudes, measured_rad[places], tolerance_rad)

    def _check_records(self, first: int, records: FusionRecords) -> None:
        if self._fusion is None:
            return
        chosen = slice(first, first + len(records.time_us))
        samples, attitudes = self._fusion.samples.select(chosen), self._fusion.attitudes[chosen]
        if len(attitudes) < len(records.time_us):
            _raise(f"the firmware answers {len(records.time_us)} records from {first} on, and made {len(attitudes)}")
        times_s = self._fusion.began_s + 1e-6 * records.time_us.astype(np.float64)
        self._check_times(self._selected[SensorKind.MAGNETOMETER], samples, times_s)
        measured_rad = self._fusion.measured_rad[chosen]
        _check_attitudes("attitude of accelerometer and magnetometer", records.measured, attitudes[:, 0], measured_rad)
        _check_attitudes("attitude of the gyroscope", records.turned, attitudes[:, 1], self._fusion.tolerance_rad)
        _check_attitudes("attitude of the filter", records.fused, attitudes[:, 2], self._fusion.tolerance_rad)

    def _check_sums(self, sensor: SensorInfo, reply: IntegrateGyroscopeReply) -> tuple[Samples, int]:
        n, samples = reply.n, self._fresh(SensorKind.GYROSCOPE)
        places = np.flatnonzero(np.all(_window_sums(samples.counts, n) == reply.total, axis=1))
        if not len(places):
            delivered = samples.counts[-n:].sum(axis=0) if len(samples.counts) >= n else np.zeros(3)
            whose = f"the {len(samples.counts)} samples" if len(samples.counts) < n else "the samples"
            difference = _difference(reply.total - delivered)
            _raise(f"{_series(sensor, n, 'sum')} is not the sum of {whose} that the sensor delivered ({difference})")
        place = int(places[-1])
        window = samples.counts[place : place + n]
        expected: dict[str, tuple[NDArray[Any], Counts]] = {
            f"sum of the first {EDGE_SAMPLES}": (reply.begin, window[:EDGE_SAMPLES].sum(axis=0)),
            f"sum of the last {EDGE_SAMPLES}": (reply.end, window[-EDGE_SAMPLES:].sum(axis=0)),
            "smallest": (reply.lowest, window.min(axis=0)),
            "largest": (reply.highest, window.max(axis=0)),
        }
        for name, (answered, delivered) in expected.items():
            if not np.array_equal(answered, delivered):
                _raise(
                    f"the firmware's {name} of {n} {sensor.name} samples is not that of the samples in the order that "
                    f"the sensor delivered them ({_difference(answered - delivered)})"
                )
        return samples, place

    def _check_span(self, sensor: SensorInfo, samples: Samples, used: slice, span: Span, *, in_log: bool) -> None:
        """Check the times of the first and last sample; a log may end with samples that waited in the FIFO."""
        near_s, instants_s = _SPAN_PERIODS * samples.period_s, samples.instant_s[used]
        waited_s = float(samples.time_s[used][-1] - instants_s[-1]) if in_log else 0.0
        times = {"last": (span.last_s, float(instants_s[-1]), near_s + waited_s)}
        if not in_log:
            times["first"] = span.first_s, float(instants_s[0]), near_s
        for name, (board_s, instant_s, late_s) in times.items():
            error_s = self._virtual_s(round(1e6 * board_s)) - instant_s
            if not -near_s <= error_s <= late_s:
                late = "after" if error_s > 0 else "before"
                _raise(
                    f"the firmware's time of the {name} {sensor.name} sample is {1e3 * abs(error_s):.2f} ms {late} the "
                    "part took it"
                )
        gaps = np.diff(samples.number[used]) > 1
        if gaps.any() and not span.lost:
            _raise(
                f"the firmware does not report that {sensor.name} samples are missing after sample {int(gaps.argmax())}"
            )


def _raise(fault: str) -> NoReturn:
    raise FirmwareContradictionError(f"the firmware contradicts the board: {fault}")


def _series(sensor: SensorInfo, n: int, statistic: str) -> str:
    return f"the firmware's {statistic} of {format_count(n, f'{sensor.kind.name.lower()} sample')}"


def _triads(gravity_g: Reals, field: Reals) -> Reals:
    """Return the attitudes of vectors, shape (n, 4); NaN if they have none."""
    attitudes = np.full((len(field), 4), np.nan)
    for index in range(len(field)):
        with suppress(DegenerateFieldError):
            attitudes[index] = triad(gravity_g[index], field[index])
    return attitudes


def _check_attitudes(name: str, answered: Reals, expected: Reals, tolerance_rad: float | Reals) -> None:
    """Compare attitudes of either sign, shape (n, 4); NaN is none."""
    angles_rad = 2.0 * np.minimum(*(np.linalg.norm(answered + sign * expected, axis=1) for sign in (-1.0, 1.0)))
    is_missing = np.isnan(answered[:, 0]) != np.isnan(expected[:, 0])
    wrong = np.flatnonzero(is_missing | (angles_rad > tolerance_rad))
    if len(wrong):
        difference = f"{math.degrees(angles_rad[wrong[0]]):.3g} degrees apart"
        _raise(
            f"the firmware's {name} does not follow from the samples that the sensors delivered "
            f"({'one of them is missing' if is_missing[wrong[0]] else difference})"
        )


def _tolerance(n: int, counts: Counts) -> float:
    """Return the largest rounding error of a mean in float32 [count], in any order of summation."""
    return (n + 1) * _FLOAT32_ROUNDING * float(np.abs(counts).max(initial=0))


def _window_sums(counts: Counts, n: int) -> Counts:
    """Return the sums of each n consecutive samples, shape (windows, 3)."""
    sums = np.vstack([np.zeros((1, 3), np.int64), np.cumsum(counts, axis=0)])
    return sums[n:] - sums[:-n]


def _places_of_mean(samples: Samples, n: int, mean: Reals, *, distinct: bool = True) -> NDArray[np.intp]:
    """Return the places at which n consecutive samples, each newer than the one before, have a mean."""
    sums = _window_sums(samples.counts, n)
    exact = np.all(np.abs(sums / n - mean) <= _tolerance(n, samples.counts), axis=1)
    if distinct and n > 1 and len(sums):
        exact &= (sliding_window_view(np.diff(samples.number), n - 1) > 0).all(axis=1)
    return np.flatnonzero(exact)


def _places_of_sequence(counts: Counts, wanted: Counts) -> NDArray[np.intp]:
    if len(counts) < len(wanted):
        return np.empty(0, np.intp)
    windows = sliding_window_view(counts, len(wanted), axis=0)
    return np.flatnonzero(np.all(windows == wanted.T, axis=(1, 2)))


def _exchanged_axes(delivered: NDArray[np.number], answered: NDArray[np.number], tolerance: float) -> str:
    """Return the axes that were exchanged or inverted, such as ``(y, x, -z)``; empty if that is not the difference."""
    for axes in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            turned = delivered[..., axes] * np.array(signs)
            if np.all(np.abs(turned - answered) <= tolerance) and not np.array_equal(turned, delivered):
                names = ("-" * (sign < 0) + "xyz"[axis] for axis, sign in zip(axes, signs, strict=True))
                return f"({', '.join(names)})"
    return ""


def _difference(counts: NDArray[np.number]) -> str:
    """Return the largest difference in words, such as ``x: 3.1 counts more``."""
    axis = int(np.abs(counts).argmax())
    return f"{'xyz'[axis]}: {abs(float(counts[axis])):.3g} counts {'more' if counts[axis] > 0 else 'less'}"


def _outside_line(group: _CollectedPoints, acceleration: Counts, place: int) -> Reals:
    """Return by how much an acceleration is beyond the line between samples at a magnetometer's sample, shape (3,)."""
    magnetometer = group.magnetometer
    low, high = _acceleration_range(group.accelerometer, float(magnetometer.instant_s[place]), magnetometer.period_s)
    return np.asarray(np.maximum(acceleration - high, 0.0) - np.maximum(low - acceleration, 0.0))


def _acceleration_range(samples: Samples, instant_s: float, period_s: float) -> tuple[Reals, Reals]:
    """Return the smallest and largest acceleration on the line between samples, near an instant [count]."""
    near_s = _PAIRING_PERIODS * (samples.period_s + period_s)
    times_s = instant_s + near_s * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    lines = np.array([np.interp(times_s, samples.instant_s, samples.counts[:, axis]) for axis in range(3)])
    return lines.min(axis=1) - _PAIRING_COUNTS, lines.max(axis=1) + _PAIRING_COUNTS
