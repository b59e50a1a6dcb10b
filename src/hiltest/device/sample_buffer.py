"""Samples that a firmware keeps in its memory, to calibrate itself from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hiltest.device.places import ReadMemory
from hiltest.device.variables import Variables
from hiltest.errors import ConfigError

_AXES = 3


class SampleBuffer:
    """Where the samples lie.

    Parameters
    ----------
    paths
        One path to all samples, x, y and z of one behind the other, or one path to each axis.
    used
        Path to a number for each cell of the buffer: one with a number below 0 is empty. None: all are used.

    Raises
    ------
    ConfigError
        When a path leads nowhere, or these are not three numbers for each cell.
    """

    def __init__(self, paths: Sequence[str], used: str | None, variables: Variables) -> None:
        self._places = [variables.place(path) for path in paths]
        self._used = None if used is None else variables.place(used)
        sizes = [len(place.scalars) for place in self._places]
        if len(set(sizes)) > 1 or len(sizes) not in (1, _AXES) or sum(sizes) % _AXES:
            found = ", ".join(f"{place.path} is {place.type_text}" for place in self._places)
            raise ConfigError(f"write one path to all samples, of three numbers each, or one to each axis ({found})")
        cells = sum(sizes) // _AXES
        if self._used is not None and len(self._used.scalars) != cells:
            raise ConfigError(f"{self._used.path} is {self._used.type_text}, and the buffer has {cells} cells")

    def counts(self, memory: ReadMemory) -> NDArray[np.float64]:
        """Return the samples of all cells that are used, in the firmware's axes, shape (n, 3) [counts]."""
        found = np.array([place.numbers(place.read(memory)) for place in self._places], dtype=np.float64)
        samples = found.reshape(-1, _AXES) if len(found) == 1 else found.T
        if self._used is None:
            return samples
        return samples[np.array(self._used.numbers(self._used.read(memory))) >= 0]
