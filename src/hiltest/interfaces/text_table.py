"""Reader of a rig's table ``[device.text]``, which reports mistakes by file, line and key."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from hiltest.errors import ConfigError, nearest_hint
from hiltest.interfaces.quantities import Moment, Quantity
from hiltest.interfaces.text_forms import ColumnForm, JsonForm, LineForm, PatternForm
from hiltest.interfaces.text_interface import TextInterface, ValueSource, component_names
from hiltest.interfaces.text_lines import Pattern
from hiltest.measurement.units import Conversion, conversion, unit_words
from hiltest.rig.text_device import COUNTS, TextDevice, TextValue
from hiltest.rig.toml_tables import RigValueError, require


def text_interface(table: TextDevice, where: Callable[[str], str]) -> TextInterface:
    """Return the interface for the lines.

    Parameters
    ----------
    where
        Returns ``file:line`` of a key below the table, with dots: ``values.heading.unit``.

    Raises
    ------
    ConfigError
        When the table contradicts itself.
    """
    try:
        patterns = [_pattern(text, "patterns") for text in table.patterns]
        sources = [*_sources(table, frozenset().union(*(pattern.groups for pattern in patterns)))]
        for pattern in patterns:
            _refuse_unknown_groups(pattern, sources)
        ready = _pattern(table.ready, "ready") if table.ready is not None else None
        error = _pattern(table.error, "error") if table.error is not None else None
    except RigValueError as wrong:
        raise ConfigError(f"{where(wrong.key)}: device.text.{wrong.key}: {wrong}") from wrong
    commands = {moment: (getattr(table.commands, moment.value) or "").encode("latin-1") for moment in Moment}
    return TextInterface(
        _form(table, patterns, sources), sources, patterns=patterns, ready=ready, error=error, commands=commands
    )


def _form(table: TextDevice, patterns: Sequence[Pattern], sources: Sequence[ValueSource]) -> LineForm:
    if table.format == "lines":
        return PatternForm(patterns)
    names = [name for source in sources for name in source.fields]
    return JsonForm(names) if table.format == "json" else ColumnForm(names, table.columns, table.separator)


def _sources(table: TextDevice, groups: frozenset[str]) -> Iterator[ValueSource]:
    """Yield the source of each quantity: from ``values``, and from groups named after quantities."""
    by_key = {quantity.key: quantity for quantity in Quantity}
    for key in table.values:
        require(key in by_key, f"values.{key}", f"is not a quantity; {nearest_hint(key, [*by_key])}")
    for quantity in Quantity:
        if quantity.key in table.values or groups & {quantity.key, *component_names(quantity)}:
            value = table.values.get(quantity.key, TextValue())
            names = value.names or _fields_named_after(quantity, table, groups)
            _check_names(quantity, names, table, groups)
            yield ValueSource(quantity, names, _conversion(quantity, value))


def _fields_named_after(quantity: Quantity, table: TextDevice, groups: frozenset[str]) -> tuple[str, ...]:
    """Return the fields that are named after a quantity."""
    components = component_names(quantity)
    candidates = {"lines": groups, "json": {quantity.key}, "csv": set(table.columns) or set(components)}[table.format]
    if quantity.key in candidates:
        return (quantity.key,)
    missing = [name for name in components if name not in candidates]
    place = "patterns" if table.format == "lines" else f"values.{quantity.key}"
    require(not missing, place, f"{quantity.key} has no {', '.join(missing)}: name its fields, or add them")
    return components


def _check_names(quantity: Quantity, names: Sequence[str], table: TextDevice, groups: frozenset[str]) -> None:
    """Refuse fields that no line can have."""
    place = f"values.{quantity.key}.fields"
    require(len(names) in (1, quantity.size), place, f"are {len(names)}, and it has {quantity.size} numbers")
    for name in names:
        if table.format == "csv" and name.isdecimal():
            within = 1 <= int(name) <= (len(table.columns) or int(name))
            require(within, place, f"has no column {name}; the first is 1")
        elif table.format == "lines" or table.columns:
            names_of_lines = groups if table.format == "lines" else table.columns
            require(name in names_of_lines, place, f"{name!r} is in no line; {nearest_hint(name, [*names_of_lines])}")


def _refuse_unknown_groups(pattern: Pattern, sources: Sequence[ValueSource]) -> None:
    used = {name for source in sources for name in source.fields}
    names = [name for quantity in Quantity for name in (quantity.key, *component_names(quantity))]
    require(bool(pattern.groups), "patterns", f"'{pattern.text}' has no named group, such as (?P<heading>[-0-9.]+)")
    for unknown in sorted(pattern.groups - used):
        raise RigValueError(
            "patterns",
            f"'{pattern.text}' has the group {unknown!r}, which is not a quantity; "
            f"{nearest_hint(unknown, [*used, *names])}",
        )


def _pattern(text: str, key: str) -> Pattern:
    try:
        return Pattern(text)
    except ValueError as error:
        raise RigValueError(key, str(error)) from error


def _conversion(quantity: Quantity, value: TextValue) -> Conversion:
    """Return the conversion of a quantity's printed numbers to its unit."""
    scale = 1.0 if value.scale is None else value.scale
    if value.unit is None or value.unit.lower() in COUNTS:
        return Conversion(scale)
    converter = conversion(value.unit, quantity.unit)
    if converter is None:
        units = ", ".join([*unit_words(quantity.unit), "count"])
        raise RigValueError(f"values.{quantity.key}.unit", f"{value.unit!r} is not a unit of it; known: {units}")
    return Conversion(scale * converter.factor, converter.offset)
