"""What PROTOCOL.md says in words of several requests, held against its table and the firmware."""

from __future__ import annotations

import re

from hiltest.link.fusion import FusionRun, FusionStart
from hiltest.link.gyroscope import GyroscopeRest, IntegrateGyroscope, LogGyroscope
from hiltest.link.messages import Average, Collect
from hiltest.link.poses import AddPose
from hiltest.link.replies import Status

from .bench import ROOT, Bench

PAGE = (ROOT / "firmware_stub" / "PROTOCOL.md").read_text(encoding="utf-8")
MEASURING = [
    Collect(4),
    Average(4),
    AddPose(4),
    GyroscopeRest(40),
    IntegrateGyroscope(40),
    LogGyroscope(8),
    FusionRun(1000),
    FusionStart(0, every=1, readings=4),
]


def test_requests_that_are_given_a_time_are_those_that_measure() -> None:
    measuring = set(re.findall(r"^\| [0-9A-F]{2} \| (\w+) \| [^|]*(?:timeout_us|duration_us \()", PAGE, re.MULTILINE))
    assert measuring == {request.command for request in MEASURING} | {"READ"}


def test_each_of_them_needs_a_sensor() -> None:
    bench = Bench()
    results = {request.command: bench.status(request.code, request.payload()) for request in MEASURING}
    assert results.pop("FUSION_RUN") is Status.NO_CALIBRATION  # before its start, which needs them
    assert set(results.values()) == {Status.SENSOR_ABSENT}
