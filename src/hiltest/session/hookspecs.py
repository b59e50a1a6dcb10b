"""Hooks that hiltest calls, for a bench's own conftest.py or plugin."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from hiltest.measurement import Measurement
    from hiltest.run_record.run import Run


@pytest.hookspec
def pytest_hil_measurement(item: pytest.Item, measurement: Measurement) -> None:
    """Receive each measurement when it is recorded, with its outcome.

    ::

        def pytest_hil_measurement(item, measurement):
            if measurement.gates:
                light_the_red_lamp()
    """


@pytest.hookspec
def pytest_hil_finished(config: pytest.Config, run: Run) -> None:
    """Receive the finished run once, after ``run.json`` and the reports are written; `run` has the verdict.

    ::

        def pytest_hil_finished(config, run):
            upload(run.board.build_id, run.verdict.sentence)
    """
