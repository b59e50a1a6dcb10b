"""Lets the command ``pytest-benchmark compare`` show device cycles.

It loads no plugins, and takes its hooks from the ``conftest.py`` of the folder that it is started in::

    from hiltest.session.compare_cycles import pytest_benchmark_group_stats, pytest_benchmark_scale_unit
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from hiltest.session.benchmark_tables import Groups, Row, scale_cycles, split_by_cycle_model

__all__ = ["pytest_benchmark_group_stats", "pytest_benchmark_scale_unit"]


# The hooks are optional: pytest loads that conftest.py as well, and pytest-benchmark may be turned off there.
@pytest.hookimpl(optionalhook=True)
def pytest_benchmark_scale_unit(
    config: Any, unit: str, benchmarks: Sequence[Row], best: Mapping[str, float], worst: Mapping[str, float], sort: str
) -> tuple[str, float]:
    """Show device cycles in cycles, and times as pytest-benchmark does."""
    from pytest_benchmark import plugin

    time_unit = config.getoption("benchmark_time_unit", None) if config else None
    scale = scale_cycles(unit, benchmarks, best, time_unit)
    if scale is not None:
        return scale
    default_scale: tuple[str, float] = plugin.pytest_benchmark_scale_unit(config, unit, benchmarks, best, worst, sort)
    return default_scale


@pytest.hookimpl(optionalhook=True)
def pytest_benchmark_group_stats(config: Any, benchmarks: Sequence[Row], group_by: str) -> Groups:
    """Group as pytest-benchmark does, and keep cycles of different models apart."""
    from pytest_benchmark import plugin

    return split_by_cycle_model(plugin.pytest_benchmark_group_stats(config, benchmarks, group_by))
