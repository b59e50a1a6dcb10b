"""Find the three magnetometer columns of a table, and their unit."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import TypeVar

from hiltest.errors import ConfigError
from hiltest.measurement.units import RATE_WORDS, AccelerationUnit, RateUnit

_U = TypeVar("_U", AccelerationUnit, RateUnit)


class Unit(StrEnum):
    """Unit of magnetometer samples; the scale of counts is unknown."""

    UT = "uT"
    GAUSS = "gauss"
    COUNTS = "counts"


#: Size of each unit in microtesla; None if unknown.
MICROTESLA: dict[Unit, float | None] = {Unit.UT: 1.0, Unit.GAUSS: 100.0, Unit.COUNTS: None}

_WORDS = {
    "ut": Unit.UT,
    "µt": Unit.UT,
    "μt": Unit.UT,
    "microtesla": Unit.UT,
    "gauss": Unit.GAUSS,
    "gs": Unit.GAUSS,
    "counts": Unit.COUNTS,
    "count": Unit.COUNTS,
    "lsb": Unit.COUNTS,
}
# Units of fields that no option names: these are refused instead of read as something else.
_FOREIGN = frozenset({"nt", "mt", "t", "tesla", "nanotesla", "mgauss", "milligauss"})
# Capital G means gauss; in lower case it is the g of accelerometers.
_CAPITALS = {"G": "gauss", "mG": "mgauss"}
_OTHER = frozenset({"g", "mg", "ms2", "si", "m/s2", "m/s^2", "m/s²"}) | RATE_WORDS.keys()
# "Magnetometer X (uT)", "mx_uT", "mag.y [gauss]": a name, and an optional unit in brackets or after an underscore.
_BRACKETED = re.compile(r"^(?P<name>.*?)\s*[(\[](?P<unit>[^)\]]*)[)\]]$")
_SUFFIXED = re.compile(r"^(?P<name>.*[^_ ])[_ ](?P<unit>[^_ ]+)$")
_BETWEEN = r"[\s_.:/-]*"
_AXIS_LAST = re.compile(rf"^(?P<stem>.*?){_BETWEEN}(?P<axis>[xyz])$")
_AXIS_FIRST = re.compile(r"^(?P<axis>[xyz])[\s_.:/-]+(?P<stem>.+)$")
_MAGNETIC = re.compile(r"mag|compass|^[mb]$")
#: Common part of the names of an accelerometer's columns.
ACCELEROMETER_STEM = re.compile(r"acc|^[af]$")
#: Common part of the names of a gyroscope's columns.
GYROSCOPE_STEM = re.compile(r"gyr|omega|angular|(?<![a-z])rate|^[gw]$")


def unit_of(headers: Sequence[str]) -> Unit | None:
    """Return the unit in headers; None without one.

    Raises
    ------
    ConfigError
        When they have different units, or an unsupported one.
    """
    words = {name_and_unit(header)[1] for header in headers}
    foreign = sorted(words & _FOREIGN)
    if foreign:
        raise ConfigError(
            f"the header says {', '.join(headers)}: {foreign[0]} is not supported; convert to uT, "
            "or give --unit counts, which checks no field strength"
        )
    units = {_WORDS[word] for word in words if word in _WORDS}
    if len(units) > 1:
        raise ConfigError(f"the header says {', '.join(headers)}: different units; say which one with --unit")
    return next(iter(units), None)


def unit_in_headers(headers: Sequence[str], words: Mapping[str, _U], option: str) -> _U | None:
    """Return the unit in three headers; None without one.

    Raises
    ------
    ConfigError
        When they have different units, or an unsupported one.
    """
    names = {name_and_unit(header)[1] for header in headers} - {""}
    units = {words.get(word) for word in names}
    if len(units) > 1 or None in units:
        raise ConfigError(
            f"the header says {', '.join(headers)}: {' and '.join(sorted(names))} is no unit that can be "
            f"read here; say one with {option}"
        )
    return next(iter(units), None)


def named_columns(
    requested: str, headers: Sequence[str], width: int, *, option: str = "--columns"
) -> tuple[int, int, int]:
    """Return the indexes of columns given as ``a,b,c``: names of the header, or numbers from 1.

    Raises
    ------
    ConfigError
        When they are not three different columns of the table.
    """
    names = [name.strip() for name in next(csv.reader([requested], skipinitialspace=True), [])]
    if len(names) != 3:
        raise ConfigError(f"{option} {requested}: {len(names)} columns; give three, for example mx,my,mz or 5,6,7")
    first, second, third = (column_index(name, headers, width, option=option) for name in names)
    if len({first, second, third}) != 3:
        raise ConfigError(f"{option} {requested}: a column is named twice")
    return first, second, third


def guessed_columns(headers: Sequence[str], places: Sequence[int], index: int | None = None) -> tuple[int, int, int]:
    """Return the indexes of the columns that must be the magnetometer's.

    Parameters
    ----------
    headers
        Names of the columns; empty without a header.
    places
        Indexes of the columns.
    index
        Index of a column that counts the rows.

    Raises
    ------
    ConfigError
        When no or more than one triple is possible; the message lists the choices.
    """
    triples = axis_triples(headers)
    magnetic = {stem: triple for stem, triple in triples.items() if _MAGNETIC.search(stem)}
    if len(magnetic) == 1:
        return next(iter(magnetic.values()))
    if len(magnetic) > 1:
        choices = [",".join(headers[index] for index in triple) for triple in magnetic.values()]
        raise ConfigError(f"more than one magnetometer: {_options(choices)}")
    if not magnetic and "" in triples:
        return triples[""]
    bare = places if len(places) == 3 else [place for place in places if place != index]
    if len(bare) == 3 and not triples:
        return bare[0], bare[1], bare[2]
    description = f"the columns are {', '.join(headers)}" if headers else f"no header and {len(places)} columns"
    choices = [",".join(headers[index] for index in triple) for triple in triples.values()]
    hint = _options(choices) if choices else "say which with --columns, by name or by number from 1: --columns 1,2,3"
    raise ConfigError(f"cannot tell which columns are the magnetometer: {description}; {hint}")


def _options(choices: Sequence[str]) -> str:
    quoted = [f"--columns '{choice}'" if " " in choice else f"--columns {choice}" for choice in choices]
    return f"choose {' or '.join(quoted)}"


def axis_triples(headers: Sequence[str]) -> dict[str, tuple[int, int, int]]:
    """Return the columns of x, y and z by the common part of their names, if all three exist once."""
    whole = {stem: axes for stem, axes in _columns_of_axes(headers).items() if sorted(axes) == ["x", "y", "z"]}
    return {
        stem: (axes["x"][0], axes["y"][0], axes["z"][0])
        for stem, axes in whole.items()
        if all(len(places) == 1 for places in axes.values())
    }


def incomplete_triples(headers: Sequence[str]) -> dict[str, list[int]]:
    """Return the columns with names of axes that are not a complete triple, by the common part of their names."""
    whole = axis_triples(headers)
    return {
        stem: sorted(place for places in axes.values() for place in places)
        for stem, axes in _columns_of_axes(headers).items()
        if stem not in whole
    }


def _columns_of_axes(headers: Sequence[str]) -> dict[str, dict[str, list[int]]]:
    """Return the columns by the common part of their names, and by their axis."""
    columns: dict[str, dict[str, list[int]]] = {}
    for index, header in enumerate(headers):
        name = name_and_unit(header)[0]
        parts = _AXIS_LAST.match(name) or _AXIS_FIRST.match(name)
        if parts is not None:
            columns.setdefault(parts["stem"], {}).setdefault(parts["axis"], []).append(index)
    return columns


def name_and_unit(header: str) -> tuple[str, str]:
    """Return name and unit of a header in lower case; the unit is empty without one."""
    written = header.strip()
    bracketed = _BRACKETED.match(written)
    if bracketed:
        return bracketed["name"].strip().lower(), _unit_word(bracketed["unit"])
    suffixed = _SUFFIXED.match(written)
    if suffixed and (unit := _unit_word(suffixed["unit"])) in {*_WORDS, *_FOREIGN, *_OTHER}:
        return suffixed["name"].lower(), unit
    return written.lower(), ""


def _unit_word(written: str) -> str:
    return _CAPITALS.get(written.strip(), written.strip().lower())


def column_index(name: str, headers: Sequence[str], width: int, *, option: str) -> int:
    """Return the index of a column by its name, or its number from 1.

    Raises
    ------
    ConfigError
        When there is none, or more than one with the name.
    """
    places = [index for index, header in enumerate(headers) if header == name]
    places = places or [index for index, header in enumerate(headers) if header.lower() == name.lower()]
    if len(places) > 1:
        raise ConfigError(f"{option}: {len(places)} columns are called {name!r}; give numbers from 1")
    if places:
        return places[0]
    if name.isascii() and name.isdigit() and 1 <= int(name) <= width:
        return int(name) - 1
    choices = f"; the columns are {', '.join(headers)}" if headers else ""
    raise ConfigError(f"{option}: no column {name!r} among {width}{choices}")


_TIME = re.compile(
    r"^(?:time|timestamp|seconds|t)[\s_.]*[(\[]?\s*(?P<unit>s|sec|seconds|ms|us|µs|μs|ns)?\s*[)\]]?$", re.IGNORECASE
)
# Unicode has two micro signs.
_SECONDS = {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}


def seconds_of(header: str) -> float | None:
    """Return the unit of a time column in seconds; None if its name is not that of a time.

    Examples
    --------
    >>> seconds_of("time_s"), seconds_of("Timestamp [ms]"), seconds_of("t"), seconds_of("temperature")
    (1.0, 0.001, 1.0, None)
    """
    matched = _TIME.match(header.strip())
    return _SECONDS.get((matched["unit"] or "s").lower(), 1.0) if matched else None
