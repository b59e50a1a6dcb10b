"""Registers of sensors: meaning of their bits, and the values that the models of the parts carry out.

The table of a part, a TOML file beside its model, is the one place of these facts; docs/sensors.md describes it.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

MOMENTS: Mapping[str, str] = {"set_up": "after set-up", "turn": "in a turn", "known_angles": "at the known angles"}
"""Moments at which a run records the registers, by the last part of the measurement's name."""

#: Group of entry points: each names the model of a part, which has its table beside it.
GROUP = "hiltest.sensors"
_TABLES = Path(__file__).parents[1] / "world" / "sensors"
# Keys of a register that only its model reads.
_OF_THE_MODEL = frozenset({"address", "size", "value", "writes", "clears", "resets"})
_ALL_BITS = 0xFF
_SETTING = re.compile(r"(\S+) (\S+) 0x[0-9A-F]{2}")


@dataclass(frozen=True, slots=True)
class Bits:
    """Bits of a register with one meaning."""

    meaning: str
    mask: int
    modelled: int | None = None
    """The only value that the part's model carries out; None if it carries out all."""


@dataclass(frozen=True, slots=True)
class Register:
    """A register that firmware can write."""

    name: str
    bits: tuple[Bits, ...]
    is_setting: bool
    """True if runs are compared in it: it is no user offset, and its part's model has the function that it sets."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Value of one register of a sensor."""

    part: str
    """Name of the part, such as ``FXOS8700CQ`` or ``onboard-FXOS8700CQ``."""
    register: str
    value: int

    @property
    def is_compared(self) -> bool:
        """True if runs are compared in this register."""
        return all(row.is_setting for row in registers_of(self.part).values() if row.name == self.register)

    @property
    def not_modelled(self) -> str:
        """Sentence about the bits that the part's model does not carry out; empty if it carries out all."""
        ignored = [
            f"{bits.meaning} is {'off, which is' if bits.modelled else 'set but'} not modelled"
            for bits in self._bits
            if bits.modelled is not None and self.value & bits.mask != bits.modelled
        ]
        return f"{self}: {', '.join(ignored)}" if ignored else ""

    @property
    def as_modelled(self) -> int:
        """Value with the bits that the part's model assumes."""
        value = self.value
        for bits in self._bits:
            value = value if bits.modelled is None else value & ~bits.mask | bits.modelled
        return value

    def describe_change(self, before: int) -> str:
        """Return the setting, its earlier value, and the meaning of the changed bits.

        Examples
        --------
        ``FXOS8700CQ M_CTRL_REG1 0x03, was 0x1F: oversampling``
        """
        changed = [bits.meaning for bits in self._bits if (self.value ^ before) & bits.mask]
        meaning = f": {', '.join(changed)}" if changed else ""
        return f"{self}, was 0x{before:02X}{meaning}"

    @property
    def _bits(self) -> tuple[Bits, ...]:
        return next((row.bits for row in registers_of(self.part).values() if row.name == self.register), ())

    def __str__(self) -> str:
        return f"{self.part} {self.register} 0x{self.value:02X}"


def names_setting(text: str) -> bool:
    """Return whether a text names a value of a known register, as in ``FXAS21002C CTRL_REG0 0x04``."""
    words = _SETTING.fullmatch(text)
    return words is not None and any(row.name == words[2] for row in registers_of(words[1]).values())


@cache
def registers_of(part: str) -> Mapping[int, Register]:
    """Return the registers of a part by address; none of an unknown part."""
    name = part.rpartition("-")[2].lower()
    folders = [_TABLES, *map(_folder_of, entry_points(group=GROUP))]
    table = next((folder / f"{name}.toml" for folder in folders if (folder / f"{name}.toml").is_file()), None)
    return {} if table is None else dict(_read_registers(tomllib.loads(table.read_text(encoding="utf-8"))))


def _folder_of(model: EntryPoint) -> Path:
    """Return the folder of a user's model, which is not imported."""
    specification = find_spec(model.module)
    return Path(specification.origin or "").parent if specification else Path()


def _read_registers(table: dict[str, Any]) -> Iterator[tuple[int, Register]]:
    offsets = table.get("offsets", [])
    groups = [
        (Bits("user offset", _ALL_BITS), first, last) for first, last in zip(offsets[::2], offsets[1::2], strict=True)
    ]
    groups += [
        (Bits(meaning, mask[0] if mask else _ALL_BITS, 0), first, last)
        for meaning, (first, last, *mask) in table.get("functions", {}).items()
    ]
    for bits, first, last in groups:
        for address in range(first, last + 1):
            yield address, Register(f"0x{address:02X}", (bits,), is_setting=False)
    for name, row in table["registers"].items():
        values = {
            meaning: mask if isinstance(mask, list) else [mask]
            for meaning, mask in row.items()
            if meaning not in _OF_THE_MODEL
        }
        if values:
            yield row["address"], Register(name, tuple(Bits(meaning, *mask) for meaning, mask in values.items()), True)
