"""Drivers from PyPI, and the time that they share with the models."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from .driver_bus import DriverClock, ImportDriver, import_driver


@pytest.fixture
def clock() -> DriverClock:
    return DriverClock()


@pytest.fixture
def driver(clock: DriverClock, monkeypatch: pytest.MonkeyPatch, require_module: Callable[[str], None]) -> ImportDriver:
    return lambda name: import_driver(name, clock, monkeypatch, require_module)
