"""The calibrators of the packaged firmware, called on a virtual board without booting: float32 results and cycles."""

from __future__ import annotations

import struct
from functools import cache
from pathlib import Path

import numpy as np

from hiltest.boards.bench import default_firmware
from hiltest.calibration.fit import Array, FitStatus, MagnetometerFit
from hiltest.errors import ConfigError
from hiltest.procedures.golden_points import golden_points
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.buffers import Address, Structure
from hiltest.virtual.counts.profiling import CallProfile, profile_call

_FIT = struct.Struct("<BBH13f")  # magnetometer_fit_t
_ENTRY = struct.Struct("<II")  # calibrator_entry_t: name and function
_LONGEST_NAME = 64
_PROFILED_POINTS = 100
_LARGEST = np.iinfo(np.int16)
MOST_POINTS = 10_000
"""Largest number of points of one call: 60 kB of the 110 kB of RAM that the firmware does not use."""


class BoardCalibrators:
    """The calibrators in the table of an ELF.

    Parameters
    ----------
    firmware
        Path of the ELF; by default the packaged one.

    Attributes
    ----------
    names : tuple of str
        Names of the calibrators; empty for an ELF without such a table.
    functions : dict of str to str
        Their functions by name.
    cycle_model : str
        Cycle model of the counts.
    """

    def __init__(self, firmware: Path | None = None) -> None:
        self._board = VirtualK64F(firmware or default_firmware())
        self.functions = dict(self._table())
        self.names = tuple(self.functions)
        sram = self._board.processor.memory.sram
        in_sram = all(
            sram.base <= self._board.image.symbols[function].address < sram.base + sram.size
            for function in self.functions.values()
        )
        self.cycle_model = f"{self._board.processor.profile.name}@{'sram' if in_sram else 'flash'}"
        # The firmware subtracts the same from each count.
        self._empty = self._call("magnetometer_empty", np.zeros((1, 3)), None)[1] if self.names else 0

    def _table(self) -> list[tuple[str, str]]:
        image, memory = self._board.image, self._board.processor.memory
        table = image.symbols.get("calibrators")
        if table is None or table.is_function:
            return []
        entries = []
        for name, function in _ENTRY.iter_unpack(memory.read(table.address, table.size)):
            text = bytes(memory.read(name, _LONGEST_NAME)).partition(b"\0")[0].decode("ascii")
            symbol = image.function_at(function & ~1)
            if symbol is None:
                raise ConfigError(f"{image.name}: the calibrator {text} is not a function of this file")
            entries.append((text, symbol.name))
        return entries

    def calibrate(self, name: str, counts: Array, *, anchor: Array | None = None) -> tuple[MagnetometerFit, int]:
        """Run a calibrator, and count its cycles.

        Parameters
        ----------
        name
            One of `names`.
        counts : shape (n, 3)
            Whole numbers in the range of int16 [counts].
        anchor : shape (3,)
            Origin of the firmware's sums, instead of the middle of the points' range [counts].

        Returns
        -------
        fit : MagnetometerFit
        cycles : int
            Cycles as the firmware reports them, excluding those of an empty call.

        Raises
        ------
        ConfigError
            If the board's RAM has no room for the points; `MOST_POINTS` always fit.
        ValueError
            If a coordinate is out of the range of int16.
        """
        fit, cycles = self._call(self.functions[name], counts, anchor)
        return fit, cycles - self._empty

    def profile(self, name: str) -> CallProfile:
        """Profile the cycles of a calibrator on the 100 golden points of a run; those of an empty call are included."""
        arguments = _arguments(golden_points(_PROFILED_POINTS).astype(float), None)
        return profile_call(self._board, self.functions[name], arguments, bytearray(_FIT.size))

    def _call(self, function: str, counts: Array, anchor: Array | None) -> tuple[MagnetometerFit, int]:
        result = bytearray(_FIT.size)
        cost = self._board.call(function, _arguments(counts, anchor), result)
        return parse_fit(result), cost.cycles


def _arguments(counts: Array, anchor: Array | None) -> Structure:
    if counts.min() < _LARGEST.min or counts.max() > _LARGEST.max:
        raise ValueError("counts are out of the range of int16")
    points = np.ascontiguousarray(counts, dtype="<i2")
    ends = [points.min(axis=0), points.max(axis=0)] if anchor is None else [anchor, anchor]
    return Structure(Address(points), np.array([len(points)], "<u2"), np.array(ends, "<i2").ravel(), np.zeros(1, "<u2"))


def parse_fit(content: bytes | bytearray) -> MagnetometerFit:
    """Return the fit at the beginning of a calibrator's result: ``magnetometer_fit_t``."""
    status, is_sphere, iterations, *floats = _FIT.unpack_from(content)
    soft_iron, hard_iron = np.array(floats[:9]).reshape(3, 3), np.array(floats[9:12])
    return MagnetometerFit(FitStatus(status), bool(is_sphere), iterations, soft_iron, hard_iron, floats[12])


@cache
def board_calibrators(firmware: Path | None = None) -> BoardCalibrators:
    """Return the calibrators of firmware, by default the packaged one, which is loaded once per process."""
    return BoardCalibrators(firmware)
