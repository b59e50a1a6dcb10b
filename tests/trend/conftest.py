"""A folder of runs that were written by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hiltest.measurement import Measurement
from hiltest.run_record.run_json import write_run

from .runs import finished_run


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes a finished run of a day in January into a folder of ``tmp_path``."""

    def write(folder: str, day: int, *measurements: Measurement, **more: Any) -> Path:
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        return write_run(finished_run(day, *measurements, **more), tmp_path / folder)

    return write
