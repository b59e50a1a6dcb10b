"""Register map of a part as data: the TOML file beside its model, which docs/sensors.md describes."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from hiltest.errors import ConfigError
from hiltest.world.recorded_motion import Sensed

_ALL_BITS = 0xFF
_ROW_KEYS = frozenset({"address", "size", "value", "writes", "clears", "resets"})
_AXES = "xyz"


class Field(NamedTuple):
    """Bits of one register with one meaning."""

    address: int
    mask: int
    shift: int
    """Position of the lowest bit."""


@dataclass(frozen=True, slots=True)
class OutputRow:
    """Output registers of one measured quantity."""

    quantity: Sensed
    first: int
    """Address of the first of six bytes."""
    range: float
    """Largest settable range of an axis [unit of the quantity]."""
    noise: float
    """Rms noise of an axis at the settings that the table's comment names [unit of the quantity]."""
    status: int | None = None
    """Register with the flags of `SampledOutput.status`; None if the model computes its flags."""
    axes: tuple[str, str, str] = ("x", "y", "z")
    """Axes of this sensor along x, y and z of the part's package, such as ``-y``."""
    full_scale: int = 32_767
    """Largest word."""
    gain_percent_per_degc: float = 0.0


@dataclass(frozen=True, slots=True)
class RegisterTable:
    """Registers, outputs and figures of a part.

    Addresses with a bank are numbers such as ``0x20F`` for register 0x0F of bank 2; a model with banks translates them.
    """

    part: str
    """Name of the part, in capitals."""
    addresses: tuple[int, ...]
    """Its possible 7-bit addresses; the first is the default."""
    names: Mapping[int, str]
    """Name of the register at each address."""
    words: Mapping[int, tuple[str, int]]
    """Name of a register of several bytes, and the position of this byte in its value, by address."""
    values: Mapping[int, int]
    """Values after reset."""
    writable: Mapping[int, int]
    clearing: Mapping[int, int]
    resetting: Mapping[int, int]
    """Bits that firmware can write, that clear themselves, and that reset the part, by address."""
    fields: Mapping[str, Field]
    """Bits by meaning."""
    outputs: tuple[OutputRow, ...]
    pins: tuple[str, ...] = ()
    """Interrupt pins by their names in the data sheet."""
    low_first: bool = True
    """True if the low byte of a word has the lower address."""
    boot_s: float = 0.0
    reset_s: float = 0.0
    """Time without an answer after power-on, and after a reset by software [s]."""
    pointer: int = _ALL_BITS
    """Bits of the register pointer on the I2C bus."""
    increment: int = 0
    """Bit of the pointer that makes it move on; 0 if it always does."""
    has_spi: bool = True
    """False if the part has I2C only."""
    spi_read: int = 0x80
    spi_increment: int = 0
    """Bits of the first byte over SPI: a read, and an address that moves on; 0 if it always does."""
    data: Mapping[str, Any] = field(default_factory=dict)
    """Figures of the data sheet for the model."""


def read_table(model: str) -> RegisterTable:
    """Return the table of a model: the TOML file beside its module, which passes its ``__file__``.

    Raises
    ------
    ConfigError
        If the file is missing or wrong.
    """
    file = Path(model).with_suffix(".toml")
    try:
        return _table(tomllib.loads(file.read_text(encoding="utf-8")))
    except (OSError, tomllib.TOMLDecodeError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"{file}: no register table: {error!r}; docs/sensors.md describes its keys") from error


def _table(content: dict[str, Any]) -> RegisterTable:
    rows: dict[str, dict[str, Any]] = content.pop("registers")
    outputs: dict[str, dict[str, Any]] = content.pop("outputs", {})
    for key in ("functions", "offsets"):  # of the settings without a model
        content.pop(key, None)
    low_first = content.get("low_first", True)
    names: dict[int, str] = {}
    words: dict[int, tuple[str, int]] = {}
    values: dict[int, int] = {}
    fields: dict[str, Field] = {}
    masks: dict[str, dict[int, int]] = {"writes": {}, "clears": {}, "resets": {}}
    for name, row in rows.items():
        address, size = row["address"], row.get("size", 1)
        for place in range(size):
            if address + place in names:
                raise ValueError(f"{name} has the address of {names[address + place]}")
            names[address + place] = name
            words[address + place] = name, place if low_first else size - 1 - place
            values[address + place] = row.get("value", 0) >> 8 * (place if low_first else size - 1 - place) & _ALL_BITS
        meanings = {
            meaning: mask[0] if isinstance(mask, list) else mask
            for meaning, mask in row.items()
            if meaning not in _ROW_KEYS
        }
        for meaning, mask in meanings.items():
            if meaning in fields:
                raise ValueError(f"{meaning!r} of {name} is also the meaning of other bits")
            fields[meaning] = Field(address, mask, (mask & -mask).bit_length() - 1)
        for key, mask in masks.items():
            mask[address] = row.get(key, 0)
        masks["writes"][address] |= sum(meanings.values()) | masks["clears"][address] | masks["resets"][address]
    figures: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in content.items()
    }
    return RegisterTable(
        names=names,
        words=words,
        values=values,
        writable=masks["writes"],
        clearing=masks["clears"],
        resetting=masks["resets"],
        fields=fields,
        outputs=tuple(_output(key, row, rows) for key, row in outputs.items()),
        **figures,
    )


def _output(key: str, row: dict[str, Any], rows: dict[str, dict[str, Any]]) -> OutputRow:
    quantity = next(quantity for quantity in Sensed if quantity.key == key)
    register, status = row.pop("register"), row.pop("status", None)
    figures: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in row.items()}
    return OutputRow(
        quantity,
        rows[register]["address"],
        status=None if status is None else rows[status]["address"],
        **figures,
    )


def axis_numbers(axes: tuple[str, str, str]) -> tuple[int, int, int]:
    """Return axes such as ``-y`` as 1, 2 or 3, negative if opposite."""
    x, y, z = ((-1 if axis.startswith("-") else 1) * (1 + _AXES.index(axis[-1])) for axis in axes)
    return x, y, z
