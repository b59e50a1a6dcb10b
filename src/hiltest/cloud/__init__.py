"""Recorded clouds of magnetometer readings: files, columns, units, and counts for the firmware."""

from __future__ import annotations

from hiltest.cloud.cloud import Cloud, read_cloud
from hiltest.cloud.columns import Unit
from hiltest.cloud.counts import CountScale, thinned

__all__ = ["Cloud", "CountScale", "Unit", "read_cloud", "thinned"]
