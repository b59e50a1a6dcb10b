"""Values of quantities from the fields of a line: plausible numbers, each in the quantity's unit."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.interfaces.quantities import Quantity
from hiltest.measurement.units import Conversion

# float() would also accept nan, infinity, 1_000 and digits of other scripts.
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
# Magnitudes that no sensor measures, by unit: two turns; a tenth of a tesla; above the sensors for the largest shocks
# and rates.
_LARGEST = {"deg": 720.0, "uT": 1e5, "g": 1e3, "dps": 1e5, "degC": 1e3, "%": 1e5, "": 1e6}
_WORDS = {**dict.fromkeys(("true", "yes", "on"), 1.0), **dict.fromkeys(("false", "no", "off"), 0.0)}
_AXES = {
    1: ("",),
    3: ("_x", "_y", "_z"),
    4: ("_w", "_x", "_y", "_z"),
    9: tuple(f"_{row}{column}" for row in "xyz" for column in "xyz"),
}


def component_names(quantity: Quantity) -> tuple[str, ...]:
    """Return the names of a quantity's numbers.

    Examples
    --------
    >>> component_names(Quantity.HEADING), component_names(Quantity.HARD_IRON)
    (('heading',), ('hard_iron_x', 'hard_iron_y', 'hard_iron_z'))
    """
    return tuple(quantity.key + axis for axis in _AXES[quantity.size])


@dataclass(frozen=True, slots=True)
class ValueSource:
    """Source of a quantity in printed fields."""

    quantity: Quantity
    fields: tuple[str, ...]
    """Fields that hold its numbers, in order."""
    conversion: Conversion
    """Conversion from the printed unit to the quantity's, scale included."""

    def value(self, fields: Mapping[str, Sequence[str]]) -> NDArray[np.float64] | str | None:
        """Return the value in the fields of a line, or the reason why it is invalid; None if a field is missing."""
        if any(name not in fields for name in self.fields):
            return None
        texts = [text for name in self.fields for text in fields[name]]
        if len(texts) != self.quantity.size:
            return f"{len(texts)} numbers, not {self.quantity.size}"
        numbers = []
        for text in texts:
            number = self._number(text)
            if isinstance(number, str):
                return number
            numbers.append(number)
        return np.array(numbers)

    def _number(self, text: str) -> float | str:
        """Return a number in the quantity's unit, or the reason why it is invalid."""
        word = _WORDS.get(text.lower()) if self.quantity is Quantity.CALIBRATED else None
        if word is not None:
            return word
        number = float(text) if _NUMBER.fullmatch(text) else math.nan
        converted = self.conversion.factor * number + self.conversion.offset
        if math.isnan(converted):
            return f"{text[:20]!r} is not a number"
        largest = _LARGEST[self.quantity.unit]
        if not abs(converted) <= largest:
            return f"{converted:g} {self.quantity.unit} is beyond {largest:g}; check its unit and scale"
        return converted
