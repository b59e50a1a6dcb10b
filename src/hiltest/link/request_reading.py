"""Read requests back from their bytes on the line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hiltest.calibration.gyroscope import GyroscopeTurn
from hiltest.calibration.still_pose import Face
from hiltest.errors import ProtocolError
from hiltest.link import accelerometer, dpi, fusion, gyroscope, poses, sequences, streams
from hiltest.link import messages as m
from hiltest.link.fields import FieldReader
from hiltest.link.framing import Frame
from hiltest.link.request import Request

_Read = Callable[[FieldReader], Request[Any]]


def _upload(fields: FieldReader) -> m.Upload:
    first, count = fields.number("H", "first"), fields.number("B", "points")
    columns = 6 if count and fields.left == 12 * count else 3
    return m.Upload(first, fields.counts(count, "points", columns=columns).tolist())


def _calibrate(fields: FieldReader) -> m.Calibrate:
    n, iterations = fields.number("H", "n"), fields.number("H", "iterations")
    return m.Calibrate(n, fields.text("calibrator"), iterations=iterations)


def _set_calibration(fields: FieldReader) -> m.SetCalibration:
    slot = fields.number("B", "slot")
    return m.SetCalibration(slot, fields.reals(9, "soft iron").reshape(3, 3), fields.reals(3, "hard iron"))


def _collect(fields: FieldReader) -> m.Collect:
    count = fields.number("H", "count")
    return m.Collect(count, timeout_us=fields.number("I", "timeout"))


def _read(fields: FieldReader) -> m.Read:
    sensor_id, count = fields.number("B", "sensor"), fields.number("B", "count")
    return m.Read(sensor_id, count, timeout_us=fields.number("I", "timeout"))


def _average(fields: FieldReader) -> m.Average:
    n, timeout_us = fields.number("H", "n"), fields.number("I", "timeout")
    return m.Average(n, fields.number("H", "slots"), timeout_us=timeout_us)


def _gyroscope_rest(fields: FieldReader) -> gyroscope.GyroscopeRest:
    n, timeout_us = fields.number("H", "n"), fields.number("I", "timeout")
    return gyroscope.GyroscopeRest(n, fields.flag("store"), fields.real("noise"), timeout_us=timeout_us)


def _integrate_gyroscope(fields: FieldReader) -> gyroscope.IntegrateGyroscope:
    n = fields.number("H", "n")
    return gyroscope.IntegrateGyroscope(n, timeout_us=fields.number("I", "timeout"))


def _log_gyroscope(fields: FieldReader) -> gyroscope.LogGyroscope:
    n, go_on = fields.number("B", "n"), fields.flag("go on")
    return gyroscope.LogGyroscope(n, go_on, timeout_us=fields.number("I", "timeout"))


def _time_sequence(fields: FieldReader) -> sequences.TimeSequence:
    return sequences.TimeSequence(fields.number("B", "sequence"), fields.choice(sequences.SequencePlace, "place"))


def _turn(fields: FieldReader) -> GyroscopeTurn:
    return GyroscopeTurn(
        fields.reals(3, "turned"),
        np.array([fields.number("i", "sum") for _ in range(3)]),
        fields.number("H", "n"),
        1e-6 * fields.number("I", "duration"),
        fields.reals(3, "bias before"),
        fields.reals(3, "bias after"),
        fields.real("share"),
    )


def _set_gyroscope(fields: FieldReader) -> gyroscope.SetGyroscope:
    return gyroscope.SetGyroscope(fields.reals(9, "matrix").reshape(3, 3), fields.reals(3, "bias"))


def _set_accelerometer(fields: FieldReader) -> accelerometer.SetAccelerometer:
    slot = fields.number("B", "slot")
    return accelerometer.SetAccelerometer(slot, fields.reals(9, "gain").reshape(3, 3), fields.reals(3, "offset"))


def _fit_accelerometer(fields: FieldReader) -> accelerometer.FitAccelerometer:
    n = fields.number("B", "n")
    return accelerometer.FitAccelerometer(n, fields.text("method"))


def _add_pose(fields: FieldReader) -> poses.AddPose:
    n, timeout_us = fields.number("H", "n"), fields.number("I", "timeout")
    return poses.AddPose(n, fields.choice(Face, "face"), timeout_us=timeout_us)


def _upload_poses(fields: FieldReader) -> poses.UploadPoses:
    first, count = fields.number("B", "first"), fields.number("B", "poses")
    return poses.UploadPoses(first, [poses.read_pose(fields) for _ in range(count)])


def _fit_dpi(fields: FieldReader) -> dpi.FitDpi:
    source, n = fields.choice(dpi.DpiSource, "source"), fields.number("H", "n")
    slot, flags = fields.number("B", "slot"), fields.number("B", "flags")
    if flags > 3:
        raise ProtocolError(f"flags {flags}, not 0 to 3")
    dip_deg = fields.real("dip")
    return dpi.FitDpi(n, slot, source=source, dip_deg=dip_deg if flags & 1 else None, is_joint=flags > 1)


def _fusion_start(fields: FieldReader) -> fusion.FusionStart:
    slot, every, readings = fields.number("B", "slot"), fields.number("B", "every"), fields.number("H", "readings")
    return fusion.FusionStart(slot, every, readings, timeout_us=fields.number("I", "timeout"))


def _stream_reset(fields: FieldReader) -> streams.StreamReset:
    sliced = fields.flag("sliced")
    return streams.StreamReset(fields.text("stream"), sliced)


def _steps(kind: type[streams.StreamFeed | streams.StreamRemove]) -> _Read:
    def read(fields: FieldReader) -> Request[Any]:
        first, count = fields.number("H", "first"), fields.number("B", "count")
        return kind(fields.text("stream"), first, count)

    return read


_READERS: Mapping[type[Request[Any]], _Read] = {
    m.Sync: lambda fields: m.Sync(fields.number("I", "nonce")),
    m.Identify: lambda _: m.Identify(),
    m.Sensors: lambda _: m.Sensors(),
    m.Select: lambda fields: m.Select(fields.number("B", "sensor")),
    m.Read: _read,
    m.Collect: _collect,
    m.Upload: _upload,
    m.Points: lambda fields: m.Points(fields.number("H", "first"), fields.number("B", "count")),
    m.ClearPoints: lambda _: m.ClearPoints(),
    m.TimeRange: lambda fields: m.TimeRange(fields.number("H", "n")),
    m.Calibrate: _calibrate,
    m.SetCalibration: _set_calibration,
    m.GetCalibration: lambda fields: m.GetCalibration(fields.number("B", "slot")),
    m.ClearCalibration: lambda fields: m.ClearCalibration(fields.number("B", "slot")),
    m.Average: _average,
    m.LinkStatistics: lambda _: m.LinkStatistics(),
    m.Reset: lambda _: m.Reset(),
    accelerometer.SetAccelerometer: _set_accelerometer,
    accelerometer.GetAccelerometer: lambda fields: accelerometer.GetAccelerometer(fields.number("B", "slot")),
    accelerometer.FitAccelerometer: _fit_accelerometer,
    poses.AddPose: _add_pose,
    poses.Poses: lambda fields: poses.Poses(fields.number("B", "first"), fields.number("B", "poses")),
    poses.ClearPoses: lambda _: poses.ClearPoses(),
    poses.UploadPoses: _upload_poses,
    dpi.FitDpi: _fit_dpi,
    fusion.FusionStart: _fusion_start,
    fusion.FusionRun: lambda fields: fusion.FusionRun(fields.number("I", "duration")),
    fusion.FusionRead: lambda fields: fusion.FusionRead(fields.number("H", "first"), fields.number("B", "records")),
    streams.StreamReset: _stream_reset,
    streams.StreamFeed: _steps(streams.StreamFeed),
    streams.StreamRemove: _steps(streams.StreamRemove),
    streams.StreamState: lambda fields: streams.StreamState(fields.text("stream")),
    gyroscope.GyroscopeRest: _gyroscope_rest,
    gyroscope.IntegrateGyroscope: _integrate_gyroscope,
    gyroscope.LogGyroscope: _log_gyroscope,
    gyroscope.FitGyroscope: lambda fields: gyroscope.FitGyroscope(
        [_turn(fields) for _ in range(fields.number("B", "turns"))]
    ),
    gyroscope.SetGyroscope: _set_gyroscope,
    gyroscope.GetGyroscope: lambda _: gyroscope.GetGyroscope(),
    sequences.TimeSequence: _time_sequence,
}
_BY_CODE = {kind.code: kind for kind in _READERS}


def command_of(code: int) -> str:
    """Return the name of a request's type; empty for an unknown code."""
    kind = _BY_CODE.get(code)
    return kind.command if kind else ""


def read_request(frame: Frame) -> Request[Any]:
    """Return the request that a frame carries.

    Raises
    ------
    ProtocolError
        When its type is unknown, or its payload does not fit.
    """
    kind = _BY_CODE.get(frame.type)
    if kind is None:
        raise ProtocolError(f"no request has type 0x{frame.type:02x}")
    fields = FieldReader(frame.payload, f"request {kind.command}")
    request = _READERS[kind](fields)
    fields.end()
    return request
