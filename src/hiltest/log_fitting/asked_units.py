"""Questions about implausible units of readings, with the likely one; units are never changed automatically."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hiltest.measurement.units import GRAVITIES, MICROTESLA, AccelerationUnit, FieldUnit

# Range of the earth's field at its surface [uT], with a margin for iron and scale, as in the rating of a fit.
_EARTH_UT = (20.0, 70.0)
_AS_COUNTS = ", or --unit counts, which checks no strength"
# Names of units that may be something else.
_ALSO = {FieldUnit.MG: "tenths of a microtesla (milligauss, or the counts of many sensors)"}
# Plausible range of the median [g], under any turning or shaking by hand; the next unit is a factor of ten off.
_GRAVITY_G = (0.7, 1.4)


def asked_of_field(strength: float, unit: FieldUnit, unit_from: str) -> Iterator[str]:
    """Yield a question if a field's strength is not the earth's, but would be in another unit.

    Parameters
    ----------
    strength
        Strength in `unit`.
    unit_from
        See `hiltest.log_fitting.samples.Samples`: there is no question about counts that are declared.
    """
    low, high = _EARTH_UT
    size_ut = MICROTESLA[unit]
    if size_ut is None:
        yield from (
            f"A strength of {strength:.3g} would be the earth's in {other}."
            for other in FieldUnit
            if unit_from == "assumed" and low <= (MICROTESLA[other] or 0.0) * strength <= high
        )
    elif not low <= size_ut * strength <= high:
        yield from (
            f"The field's strength is {strength:.3g} {unit}, and the earth's is {low:g} to {high:g} uT. Are these "
            f"{_ALSO.get(other, other)}? use --unit {other}{_AS_COUNTS if other in _ALSO else ''}."
            for other, other_ut in MICROTESLA.items()
            if low <= (other_ut or 0.0) * strength <= high
        )


def asked_of_gravity(acceleration: NDArray[np.float64], unit: AccelerationUnit, then: str) -> Iterator[str]:
    """Yield a question if an accelerometer does not read 1 g in the median, but would in another unit.

    Parameters
    ----------
    acceleration : shape (n, 3)
        Readings in `unit`; rows with NaN are ignored.
    then
        Remedy if it is the other unit, which replaces {}.
    """
    lengths = np.linalg.norm(acceleration, axis=1)
    lengths = lengths[np.isfinite(lengths)]
    middle = float(np.median(lengths)) if len(lengths) else math.nan
    low, high = _GRAVITY_G
    if low <= (GRAVITIES[unit] or math.nan) * middle <= high:
        return
    for other, size_g in GRAVITIES.items():
        # A thousand counts per g are as likely as mg.
        if (
            size_g is not None
            and {unit, other} != {AccelerationUnit.COUNTS, AccelerationUnit.MG}
            and low <= (size_g * middle) <= high
        ):
            yield (
                f"The accelerometer reads {middle:.3g} {unit} in the median, and gravity is 1 g. Are these {other}? "
                f"{then.format(other)}."
            )
