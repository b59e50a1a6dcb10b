"""The board's temperature over time."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Temperature:
    """Course of the temperature from power-on: constant, a straight line, or an exponential approach."""

    begin_degc: float = 25.0
    """Temperature at power-on."""
    end_degc: float | None = None
    """Final temperature; None for a constant one."""
    ramp_s: float | None = None
    """Duration of a linear change."""
    time_constant_s: float | None = None
    """Time constant of the approach, without a ramp."""

    def __post_init__(self) -> None:
        courses = [course for course in (self.ramp_s, self.time_constant_s) if course is not None]
        if len(courses) != (0 if self.end_degc is None else 1):
            raise ValueError("a temperature that changes has an end, and either a ramp or a time constant")
        if any(duration_s <= 0.0 for duration_s in courses):
            raise ValueError("a temperature takes more than 0 s to change")

    def temperature_at(self, time_s: float) -> float:
        """Return the temperature at a virtual time [degC]."""
        if self.end_degc is None:
            return self.begin_degc
        if self.time_constant_s is not None:
            remaining = math.exp(-time_s / self.time_constant_s)
        else:
            assert self.ramp_s is not None
            remaining = max(0.0, 1.0 - time_s / self.ramp_s)
        # Rounded, because exponentials may differ in the last bit between hosts.
        return round(self.end_degc + (self.begin_degc - self.end_degc) * remaining, 6)
