"""Samples that firmware stores in its memory for its calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hiltest.errors import ConfigError
from hiltest.interfaces.places import ReadMemory
from hiltest.interfaces.variables import Variables

_AXES = 3


class SampleBuffer:
    """Places of the samples.

    Parameters
    ----------
    paths
        One path to all samples, with consecutive x, y and z, or one path per axis.
    used
        Path to a number for each cell of the buffer, below 0 if the cell is empty; None if all cells are used.

    Raises
    ------
    ConfigError
        When a path leads nowhere, or there are not three numbers for each cell.
    """

    def __init__(self, paths: Sequence[str], used: str | None, variables: Variables) -> None:
        self._places = [variables.place(path) for path in paths]
        self._used = None if used is None else variables.place(used)
        sizes = [len(place.scalars) for place in self._places]
        if len(set(sizes)) > 1 or len(sizes) not in (1, _AXES) or sum(sizes) % _AXES:
            types = ", ".join(f"{place.path} is {place.type_text}" for place in self._places)
            raise ConfigError(f"write one path to all samples, of three numbers each, or one to each axis ({types})")
        cells = sum(sizes) // _AXES
        if self._used is not None and len(self._used.scalars) != cells:
            raise ConfigError(f"{self._used.path} is {self._used.type_text}, and the buffer has {cells} cells")

    def counts(self, memory: ReadMemory) -> NDArray[np.float64]:
        """Return the samples of all used cells, in the firmware's axes, shape (n, 3) [counts]."""
        values = np.array([place.numbers(place.read(memory)) for place in self._places], dtype=np.float64)
        samples = values.reshape(-1, _AXES) if len(values) == 1 else values.T
        if self._used is None:
            return samples
        return samples[np.array(self._used.numbers(self._used.read(memory))) >= 0]
