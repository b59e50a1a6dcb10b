"""The table ``[device.text]``: firmware that prints lines."""

from __future__ import annotations

from dataclasses import dataclass, fields
from dataclasses import field as dataclass_field
from typing import Literal

from hiltest.budgets import PATTERNS, BudgetError
from hiltest.rig.toml_tables import StrictTable, require

#: Units whose size is defined by the scale.
COUNTS = frozenset({"count", "counts", "lsb"})


@dataclass(frozen=True, slots=True)
class TextValue(StrictTable):
    """Fields and unit of a quantity's printed numbers."""

    fields: str | int | tuple[str | int, ...] | None = None
    """Groups, JSON paths or columns that hold its numbers in order; None for those with the quantity's name,
    ``magnetometer`` or ``magnetometer_x``, ``magnetometer_y`` and ``magnetometer_z``."""
    unit: str | None = None
    """Unit of a number times `scale`; None for the quantity's own. ``count`` is also the quantity's own, with a
    scale."""
    scale: float | None = None
    """Factor on the number; None for 1."""

    def __post_init__(self) -> None:
        require(self.scale != 0.0, "scale", "must not be 0")
        require(
            self.scale is not None or str(self.unit).lower() not in COUNTS,
            "unit",
            f"{self.unit!r} needs a scale: one count in the quantity's unit",
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Fields; empty if they have the quantity's name."""
        if self.fields is None:
            return ()
        return tuple(map(str, (self.fields,) if isinstance(self.fields, str | int) else self.fields))


@dataclass(frozen=True, slots=True)
class TextCommands(StrictTable):
    """Commands at the moments of the procedure; characters up to U+00FF are sent as single bytes."""

    start: str = ""
    before_tumble: str = ""
    after_tumble: str = ""
    pose: str = ""
    ask: str | None = None
    """Request for the next values, sent when the last one is answered, or a window after it without an answer."""

    def __post_init__(self) -> None:
        for field in fields(self):
            require(
                all(ord(letter) < 0x100 for letter in getattr(self, field.name) or ""),
                field.name,
                "has a character above U+00FF, which is not a byte",
            )


@dataclass(frozen=True, slots=True)
class TextDevice(StrictTable):
    """Interface to firmware that prints lines."""

    format: Literal["lines", "json", "csv"] = "lines"
    """``lines``: named groups of `patterns`; ``json``: one object per line; ``csv``: columns."""
    patterns: tuple[str, ...] = ()
    """Regular expressions, each searched in every line."""
    columns: tuple[str, ...] = ()
    """Names of all columns, if the firmware prints no header; columns may then also be given by number."""
    separator: str = ","
    """Separator of columns; a blank stands for any number of blanks and tabs."""
    ready: str | None = None
    error: str | None = None
    """Regular expressions of lines that report a calibrated magnetometer, and an error: the group ``error``, or the
    whole line."""
    values: dict[str, TextValue] = dataclass_field(default_factory=dict)
    """Values by the quantity's name."""
    commands: TextCommands = dataclass_field(default_factory=TextCommands)

    def __post_init__(self) -> None:
        is_csv = self.format == "csv"
        of_lines = self.format == "lines"
        require(of_lines == bool(self.patterns), "patterns", 'require format = "lines"')
        try:
            PATTERNS.check(items=len(self.patterns), size=sum(map(len, self.patterns)))
        except BudgetError as error:
            require(False, "patterns", f"are {error}")
        require(is_csv or not self.columns, "columns", 'belong to format = "csv"')
        require(is_csv or self.separator == ",", "separator", 'belongs to format = "csv"')
        require(len(self.separator) == 1, "separator", "must be one character")
        require(bool(self.patterns or self.values), "values", "is missing: it has the place of each quantity")
