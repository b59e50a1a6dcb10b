"""Change of a reading with temperature."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.world import Vector

#: Reference temperature of data sheets, at which the drift is zero.
REFERENCE_DEGC = 25.0
_NOTHING: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Drift:
    """Temperature coefficients of a three-axis sensor, body frame.

    Notes
    -----
    ``drifted = (1 + gain_per_degc * dT) * reading + offset_per_degc * dT``, dT from `REFERENCE_DEGC`. Without
    coefficients a reading is unchanged to the last bit.
    """

    offset_per_degc: Vector = _NOTHING
    """Change of the offset, in the unit of the reading."""
    gain_per_degc: Vector = _NOTHING
    """Change of the sensitivity [1/degC]."""

    def apply(self, reading: Vector, temperature_degc: float) -> Vector:
        """Return the reading of the part at a temperature."""
        above = temperature_degc - REFERENCE_DEGC
        offset, gain = self.offset_per_degc, self.gain_per_degc
        return (
            reading[0] * (1.0 + gain[0] * above) + offset[0] * above,
            reading[1] * (1.0 + gain[1] * above) + offset[1] * above,
            reading[2] * (1.0 + gain[2] * above) + offset[2] * above,
        )
