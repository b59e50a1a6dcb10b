"""The table ``[device.text]``: firmware that prints lines."""

from __future__ import annotations

from dataclasses import dataclass, fields
from dataclasses import field as dataclass_field
from typing import Any, ClassVar, Literal

from hiltest.rig.tables import STRICT, require

#: Units whose size the scale says.
COUNTS = frozenset({"count", "counts", "lsb"})


@dataclass(frozen=True, slots=True)
class TextValue:
    """Where the numbers of a quantity are printed, and in which unit."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    fields: str | int | tuple[str | int, ...] | None = None
    """Groups, JSON paths or columns that hold its numbers one after the other. None: those of the quantity's name,
    ``magnetometer`` or ``magnetometer_x``, ``magnetometer_y`` and ``magnetometer_z``."""
    unit: str | None = None
    """Of a number times `scale`; None is the quantity's own. ``count`` is the quantity's own too, with a scale."""
    scale: float | None = None
    """None is 1."""

    def __post_init__(self) -> None:
        require(self.scale != 0.0, "scale", "must not be 0")
        require(self.scale is not None or str(self.unit).lower() not in COUNTS, "unit",
                f"{self.unit!r} needs a scale: what one count is in the quantity's unit")

    @property
    def names(self) -> tuple[str, ...]:
        """The fields; none when they are those of the quantity's name."""
        if self.fields is None:
            return ()
        return tuple(map(str, (self.fields,) if isinstance(self.fields, str | int) else self.fields))


@dataclass(frozen=True, slots=True)
class TextCommands:
    """What is sent at the moments of the procedure; characters up to U+00FF are the bytes of their number."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    start: str = ""
    before_tumble: str = ""
    after_tumble: str = ""
    pose: str = ""

    def __post_init__(self) -> None:
        for field in fields(self):
            require(all(ord(letter) < 0x100 for letter in getattr(self, field.name)), field.name,
                    "has a character that is no byte: those up to U+00FF are")


@dataclass(frozen=True, slots=True)
class TextDevice:
    """Lines that firmware prints."""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT
    format: Literal["lines", "json", "csv"] = "lines"
    """``lines``: named groups of `patterns`; ``json``: an object a line; ``csv``: columns."""
    patterns: tuple[str, ...] = ()
    """Regular expressions; every one is searched in every line."""
    columns: tuple[str, ...] = ()
    """Names of all columns, where the firmware prints no line with them; columns may be given by number then too."""
    separator: str = ","
    """Between columns; a blank stands for any number of blanks and tabs."""
    ready: str | None = None
    error: str | None = None
    """Regular expressions of lines that say that the magnetometer is calibrated, and that something is wrong, which
    is the group ``error`` or else the whole line."""
    values: dict[str, TextValue] = dataclass_field(default_factory=dict)
    """By the quantity's name."""
    commands: TextCommands = dataclass_field(default_factory=TextCommands)

    def __post_init__(self) -> None:
        is_csv = self.format == "csv"
        of_lines = self.format == "lines"
        require(of_lines == bool(self.patterns), "patterns", 'go with format = "lines", and only with it')
        require(is_csv or not self.columns, "columns", 'belong to format = "csv"')
        require(is_csv or self.separator == ",", "separator", 'belongs to format = "csv"')
        require(len(self.separator) == 1, "separator", "must be one character")
        require(bool(self.patterns or self.values), "values", "is missing: it says where each quantity is")
