"""Attitude from sensors, in float64."""

from __future__ import annotations

from hiltest.orientation.tilt_heading import DegenerateFieldError, earth_axes, tilt_heading

__all__ = ["DegenerateFieldError", "earth_axes", "tilt_heading"]
