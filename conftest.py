"""Hooks for `pytest-benchmark compare` in this folder: device cycles are shown in cycles."""

from __future__ import annotations

from hiltest.session.compare_cycles import pytest_benchmark_group_stats, pytest_benchmark_scale_unit

__all__ = ["pytest_benchmark_group_stats", "pytest_benchmark_scale_unit"]
