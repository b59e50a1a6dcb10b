"""A calibrator in an image for a Cortex-M4, which the emulated core executes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hiltest.errors import BoardFault, ConfigError
from hiltest.judge.answers import Answer, Cloud
from hiltest.virtual.calls.calling import find_function
from hiltest.virtual.profiling.image import ProfiledImage

CALIBRATE, CALIBRATE_PAIRS = "calibrate", "calibrate_pairs"
TIMEOUT_S = 60.0
"""Longest virtual time of a call, 7 200 million cycles."""
_GUARD = np.float32(-1.2345678e30)
_GUARDS = 8  # numbers behind each output that the function must not change


class ImageCalibrator:
    """A calibrator of an image.

    Parameters
    ----------
    name
        Name in tables.
    file
        ELF of any program for a Cortex-M4.
    function
        Function of the contract in ``hiltest_judge.h``.
    built_by
        Compiler and flags; by default those in the image.
    part
        Part whose memories and timing are used, by default a Cortex-M4 without waits, or the small core of the image.

    Raises
    ------
    ConfigError
        If the file has no such function, or another contract.
    """

    def __init__(self, name: str, file: Path, function: str, *, built_by: str = "", part: str | None = None) -> None:
        self._image = ProfiledImage(file, part=part)
        image = self._image.board.image
        self.name, self._function = name, find_function(image, function).name
        self.built_by = built_by or image.compiler_flags
        self.flash_bytes: int | None = sum(len(segment.data) for segment in image.segments)
        signature = image.signature(self._function)
        count = None if signature is None else len(signature.parameters)
        self.takes_pairs = count == 5 or (count is None and function == CALIBRATE_PAIRS)
        if count not in (None, 4, 5):
            raise ConfigError(
                f"{file}: {function} takes {count} arguments; a calibrator takes samples, n, hard_iron and soft_iron, "
                "or accelerations after the samples, as hiltest_judge.h has it"
            )
        self.cycle_model = ""

    def answer(self, cloud: Cloud) -> Answer:
        """Calibrate from samples.

        Raises
        ------
        BoardFault
            If the function faults or does not return.
        ConfigError
            If it writes outside its outputs.
        """
        samples = cloud.samples_ut.astype(np.float32)
        inputs = [samples, cloud.accelerations_g.astype(np.float32)] if self.takes_pairs else [samples]
        before = [numbers.copy() for numbers in inputs]
        hard_iron, soft_iron = (_guarded(size) for size in (3, 9))
        try:
            called = self._image.call(self._function, *inputs, len(samples), hard_iron, soft_iron, timeout_s=TIMEOUT_S)
        except BoardFault as fault:
            raise fault.located(f"{self.name} {cloud.where}") from fault
        self.cycle_model = called.cycle_model
        changed = not all(np.array_equal(one, other) for one, other in zip(inputs, before, strict=True))
        overwritten = changed or any((output[-_GUARDS:] != _GUARD).any() for output in (hard_iron, soft_iron))
        if overwritten:
            raise ConfigError(f"{self.name} writes outside hard_iron and soft_iron {cloud.where}")
        return Answer(
            bool(called.value),
            hard_iron[:3].astype(float),
            soft_iron[:9].astype(float).reshape(3, 3),
            cycles=called.cycles,
            band=called.band,
            stack_bytes=called.stack_bytes,
        )


def _guarded(size: int) -> np.ndarray:
    """Return zeros for an output, and guards behind it."""
    output = np.zeros(size + _GUARDS, np.float32)
    output[size:] = _GUARD
    return output
