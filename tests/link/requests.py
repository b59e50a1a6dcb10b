"""A request of each kind."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hiltest.calibration.gyroscope import GyroscopeTurn
from hiltest.calibration.still_pose import Face, StillPose
from hiltest.link import gyroscope as g
from hiltest.link import messages as m
from hiltest.link import streams
from hiltest.link.accelerometer import FitAccelerometer, GetAccelerometer, SetAccelerometer
from hiltest.link.dpi import DpiSource, FitDpi
from hiltest.link.fusion import FusionRead, FusionRun, FusionStart
from hiltest.link.poses import AddPose, ClearPoses, Poses, UploadPoses
from hiltest.link.request import Request
from hiltest.link.sequences import SequencePlace, TimeSequence

POSE = StillPose(np.array([1.5, -2.0, 3.0]), np.ones(3), np.array([0.0, 8192.0, -1.0]), np.zeros(3), 16, Face.PLUS_Y)
TURN = GyroscopeTurn(np.array([0.0, 0, 360]), np.array([-5, 7, 2_000_000]), 1200, 5.995, np.ones(3), np.zeros(3), 0.25)
REQUESTS: list[Request[Any]] = [
    m.Sync(0x12345678),
    m.Identify(),
    m.Sensors(),
    m.Select(3),
    m.Read(2, 64, timeout_us=7),
    m.Collect(512),
    m.Upload(7, [[1, -2, 3], [-32768, 32767, 0]]),
    m.Points(300, 80),
    m.ClearPoints(),
    m.TimeRange(258),
    m.Calibrate(100, "iterative", iterations=5),
    m.SetCalibration(1, np.arange(9).reshape(3, 3), [0.5, 0, -1]),
    m.GetCalibration(2),
    m.ClearCalibration(7),
    m.Average(16, 0b101, timeout_us=9),
    m.LinkStatistics(),
    m.Reset(),
    streams.StreamReset("direct-stream", sliced=True),
    streams.StreamFeed("direct-stream", 9, 80),
    streams.StreamRemove("direct-stream", 0, 1),
    streams.StreamState("iterative-stream"),
    SetAccelerometer(15, np.eye(3) / 8192, [1, -2, 0.5]),
    GetAccelerometer(3),
    FitAccelerometer(6, "six-position"),
    AddPose(64, Face.MINUS_Y),
    Poses(3, 20),
    ClearPoses(),
    UploadPoses(0, [POSE, replace(POSE, magnetometer_spread=None)]),
    g.GyroscopeRest(64, store=True, noise=4.0),
    g.IntegrateGyroscope(40),
    g.LogGyroscope(128, go_on=True),
    g.FitGyroscope([TURN]),
    g.SetGyroscope(np.arange(9).reshape(3, 3), [0.5, 0, -1]),
    g.GetGyroscope(),
    TimeSequence(22, SequencePlace.FLASH_ALONE),
    m.Upload(0, [[1, -2, 3, 4, -5, 8192]]),
    FitDpi(300, 2, dip_deg=-62.5),
    FitDpi(38, 15, source=DpiSource.POSES),
    FitDpi(100, 3, dip_deg=62.5, is_joint=True),
    FitDpi(100, 3, is_joint=True),
    FusionStart(3, 5, 16, timeout_us=9),
    FusionRun(24_000_000),
    FusionRead(36, 12),
]
