"""The ``[device.memory]`` table of a rig: quantities by the names of the firmware's variables."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from hiltest.rig.toml_tables import StrictTable, require

_SERVER = re.compile(r"(?P<host>[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]):(?P<port>[0-9]{1,5})")


def _as_tuple(path: str | tuple[str, ...]) -> tuple[str, ...]:
    return (path,) if isinstance(path, str) else path


@dataclass(frozen=True, slots=True)
class MemoryValue(StrictTable):
    """The variables of a quantity."""

    path: str | tuple[str, ...]
    """One path to all numbers, ``sfg.MagCal.fV``, or one path to each."""
    unit: str | None = None
    """The firmware's unit. It may only be omitted if the quantity has none."""
    scale: float = 1.0
    """Factor from the variables to that unit."""
    type: str | None = None
    """Their type, such as ``float[3]``, if the ELF has symbols but no debug information for them."""

    def __post_init__(self) -> None:
        require(bool(self.paths) and all(self.paths), "path", 'names no variable; write one as in C: "sfg.MagCal.fV"')
        require(math.isfinite(self.scale) and self.scale != 0.0, "scale", "must not be zero")

    @property
    def paths(self) -> tuple[str, ...]:
        """Paths as a tuple."""
        return _as_tuple(self.path)


@dataclass(frozen=True, slots=True)
class KeptSamples(StrictTable):
    """Magnetometer samples of the firmware's self-calibration."""

    path: str | tuple[str, ...]
    """One path to all samples, with consecutive x, y and z, or one path per axis."""
    used: str | None = None
    """Path to a number for each sample, below 0 if it is absent; None if all are present."""

    @property
    def paths(self) -> tuple[str, ...]:
        """Paths as a tuple."""
        return _as_tuple(self.path)


@dataclass(frozen=True, slots=True)
class MemoryDevice(StrictTable):
    """Reading of a board's memory."""

    values: dict[str, MemoryValue] = field(default_factory=dict)
    """Variables by the quantity's name."""
    server: str | None = None
    """``host:port`` of the GDB server of a real board's probe; None for a virtual board."""
    at_return_of: str | None = None
    """Function at whose return all values are read, because it writes them together."""
    samples: KeptSamples | None = None
    """Samples for hiltest's calibrators, on a virtual board as of the start of the latest solution."""

    def __post_init__(self) -> None:
        require(
            bool(self.values),
            "values",
            'has no quantity; write hard_iron = { path = "sfg.MagCal.fV", '
            'unit = "uT" } or others under [device.memory.values]',
        )
        if self.server is not None:
            match = _SERVER.fullmatch(self.server)
            require(
                match is not None and 0 < int(match["port"]) < 1 << 16,
                "server",
                'is host:port of a GDB server, such as "localhost:3333"',
            )

    @property
    def address(self) -> tuple[str, int] | None:
        """Host and port of the server; None without one."""
        match = _SERVER.fullmatch(self.server or "")
        return (match["host"].strip("[]"), int(match["port"])) if match else None
