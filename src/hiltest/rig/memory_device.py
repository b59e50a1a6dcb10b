"""The ``[device.memory]`` table of a rig: quantities by the names of the firmware's variables."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any, ClassVar

from hiltest.rig.tables import STRICT, require

_SERVER = re.compile(r"(?P<host>[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]):(?P<port>[0-9]{1,5})")


def _several(path: str | tuple[str, ...]) -> tuple[str, ...]:
    return (path,) if isinstance(path, str) else path


@dataclass(frozen=True, slots=True)
class MemoryValue:
    """The variables of a quantity."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    path: str | tuple[str, ...]
    """One path to all of its numbers, ``sfg.MagCal.fV``, or one to each."""
    unit: str | None = None
    """The firmware's unit. May be left out only where the quantity has none."""
    scale: float = 1.0
    """What the variables are multiplied by to be in that unit."""
    type: str | None = None
    """Their type, ``float[3]``, where the ELF has a symbol and no debug information of them."""

    def __post_init__(self) -> None:
        require(bool(self.paths) and all(self.paths), "path", 'names no variable; write one as in C: "sfg.MagCal.fV"')
        require(math.isfinite(self.scale) and self.scale != 0.0, "scale", "must not be zero")

    @property
    def paths(self) -> tuple[str, ...]:
        """The paths, always several."""
        return _several(self.path)


@dataclass(frozen=True, slots=True)
class KeptSamples:
    """The magnetometer samples that the firmware calibrates itself from."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    path: str | tuple[str, ...]
    """One path to all of them, x, y and z of one behind the other, or one path to each axis."""
    used: str | None = None
    """Path to a number for each: where it is below 0, there is none. None: all are there."""

    @property
    def paths(self) -> tuple[str, ...]:
        """The paths, always several."""
        return _several(self.path)


@dataclass(frozen=True, slots=True)
class MemoryDevice:
    """Reading of a board's memory."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    values: dict[str, MemoryValue] = field(default_factory=dict)
    """By the quantity's name."""
    server: str | None = None
    """``host:port`` of the GDB server of a real board's probe; None for a virtual board, which needs none."""
    at_return_of: str | None = None
    """Function at whose return all values are read: it writes what belongs together."""
    samples: KeptSamples | None = None
    """hiltest's own calibrators get them, on a virtual board, as they were when the latest solution began."""

    def __post_init__(self) -> None:
        require(bool(self.values), "values", 'names no quantity; write hard_iron = { path = "sfg.MagCal.fV", '
                'unit = "uT" } or others under [device.memory.values]')
        if self.server is not None:
            match = _SERVER.fullmatch(self.server)
            require(match is not None and 0 < int(match["port"]) < 1 << 16, "server",
                    'is host:port of a GDB server, such as "localhost:3333"')

    @property
    def address(self) -> tuple[str, int] | None:
        """Host and port of the server; None without one."""
        match = _SERVER.fullmatch(self.server or "")
        return (match["host"].strip("[]"), int(match["port"])) if match else None
