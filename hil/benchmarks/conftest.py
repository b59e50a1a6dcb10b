"""Device cycles of the firmware's kernels in tables of pytest-benchmark: ``pytest hil/benchmarks``.

Benchmarks do not affect the exit code; suites and limits do. The hooks below format cycles for ``pytest-benchmark
compare`` if it is started in this folder.
"""

from __future__ import annotations

import pytest

from hiltest.session.compare_cycles import pytest_benchmark_group_stats, pytest_benchmark_scale_unit

__all__ = ["pytest_benchmark_group_stats", "pytest_benchmark_scale_unit"]


def pytest_configure(config: pytest.Config) -> None:
    """Save each run in ``.benchmarks`` for ``pytest-benchmark compare``."""
    if hasattr(config.option, "benchmark_autosave"):  # pytest-benchmark may be turned off
        config.option.benchmark_autosave = True
