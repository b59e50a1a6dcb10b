"""Units that readings cannot be in, and which they may be in: asked about, and never changed."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hiltest.recordings.columns import MICROTESLA, Unit
from hiltest.units import GRAVITIES, AccelerationUnit

# Of the earth's field at its surface [uT], with room for iron and scale: what a fit is rated by.
_EARTH_UT = (20.0, 70.0)
_AS_COUNTS = "--unit counts takes them as they are, and checks no strength"
# What one of a unit is [uT], and what to do where readings are in it.
_FIELDS = {
    "uT": (1.0, "--unit uT says so"),
    "gauss": (100.0, "--unit gauss says so"),
    "tenths of a microtesla (milligauss, or the counts of many sensors)": (0.1, _AS_COUNTS),
    "nT": (1e-3, _AS_COUNTS),
    "mT": (1e3, _AS_COUNTS),
}  # fmt: skip
# A median about 1 g, however the board is turned or shaken by hand; the next unit is a factor of ten off.
_GRAVITY_G = (0.7, 1.4)


def asked_of_field(strength: float, unit: Unit, unit_from: str) -> Iterator[str]:
    """Yield a question where a field's strength is not the earth's, and would be in another unit.

    Parameters
    ----------
    strength
        In `unit`.
    unit_from
        As in `hiltest.logs.samples.Samples`: counts are asked about only where nothing says that they are counts.
    """
    low, high = _EARTH_UT
    size_ut = MICROTESLA[unit]
    if size_ut is None:
        yield from (f"A strength of {strength:.3g} would be the earth's in {each}." for each in Unit
                    if unit_from == "assumed" and low <= (MICROTESLA[each] or 0.0) * strength <= high)
    elif not low <= size_ut * strength <= high:
        yield from (
            f"The field's strength is {strength:.3g} {unit}, and the earth's is {low:g} to {high:g} uT. Are these "
            f"{name}? {then}." for name, (each_ut, then) in _FIELDS.items() if low <= each_ut * strength <= high
        )


def asked_of_gravity(acceleration: NDArray[np.float64], unit: AccelerationUnit, then: str) -> Iterator[str]:
    """Yield a question where an accelerometer does not read 1 g in the median, and would in another unit.

    Parameters
    ----------
    acceleration : shape (n, 3)
        In `unit`; rows with NaN do not count.
    then
        What to do where it is the other unit, which is put in for {}.
    """
    lengths = np.linalg.norm(acceleration, axis=1)
    lengths = lengths[np.isfinite(lengths)]
    middle = float(np.median(lengths)) if len(lengths) else math.nan
    low, high = _GRAVITY_G
    if low <= (GRAVITIES[unit] or math.nan) * middle <= high:
        return
    for other, size_g in GRAVITIES.items():
        # A thousand counts for 1 g are as likely as mg.
        if size_g is not None and {unit, other} != {AccelerationUnit.COUNTS, AccelerationUnit.MG} and low <= (
            size_g * middle
        ) <= high:
            yield (f"The accelerometer reads {middle:.3g} {unit} in the median, and gravity is 1 g. Are these {other}? "
                   f"{then.format(other)}.")
