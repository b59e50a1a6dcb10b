"""Find the three magnetometer columns of a table, and their unit."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import TypeVar

from hiltest.errors import ConfigError
from hiltest.interfaces.sensor_files.cells import is_number
from hiltest.measurement.units import (
    ACCELERATION_WORDS,
    FIELD_WORDS,
    RATE_WORDS,
    AccelerationUnit,
    FieldUnit,
    RateUnit,
    unit_word,
)

_U = TypeVar("_U", AccelerationUnit, RateUnit)


# Words for units of any sensor.
_UNIT_WORDS = FIELD_WORDS | RATE_WORDS | ACCELERATION_WORDS
_SIZED = frozenset(word for word, unit in _UNIT_WORDS.items() if unit != "counts")
# "Magnetic Field in uT", "Magnetometer (gauss)", in lines above a table.
_IN_WORDS = re.compile(r"(?i:mag|compass|field)[^\n]{0,40}?(?:\bin |[(\[])\s*([^\W\d]{1,12})\b")
# Words in a row of units, for columns that are not read.
_OTHER_UNITS = frozenset(
    re.split(
        " ",
        "s ms us ns sec msec usec secs msecs degc °c c k % pa hpa kpa mbar v mv a hz m bits flags u. no_units - ° date",
    )
)
#: Longest name in which axes and units are looked for: the time for that may grow with the square of the length.
LONGEST_NAME = 200
# "Magnetometer X (uT)", "mx_uT", "mag.y [gauss]": a name, and an optional unit in brackets or after an underscore.
_BRACKETED = re.compile(r"^(?P<name>.*?)\s*[(\[](?P<unit>(?:[^()\[\]]|\([^()]*\))*)[)\]]$")
_SUFFIXED = re.compile(r"^(?P<name>.*[^_ ])[_ ](?P<unit>[^_ ]+)$")
_INDEXED = re.compile(r"^(?P<name>.+)(?P<index>\.[xyz]|[(\[]\d+[)\]])$", re.IGNORECASE)
_GLUED = re.compile(r"^(?P<name>.*[XYZ])(?P<unit>[A-Za-z]\w+)$")
_BETWEEN = r"[\s_.:/-]*"
# Axes in names: "mag_x", "mx", "magADC[0]"; "x_mag", "xmag"; "Shimmer_Mag_X_CAL".
_AXES = (
    re.compile(rf"^(?P<stem>.*?){_BETWEEN}(?P<axis>[xyz])$"),
    re.compile(r"^(?P<stem>.+?)(?:_|\s*[\[(])(?P<axis>[012])[\])]?$"),
    re.compile(r"^(?P<axis>[xyz])(?:[\s_.:/-]+(?P<stem>.+)|(?P<sensor>mag|acc|gyro?|rate))$"),
    re.compile(r"^(?P<stem>.+)[\s_.:/-](?P<axis>[xyz])[\s_.:/-]+(?P<rest>.+)$"),
)
# A name that is that of a magnetometer only by "field", or that of a property of its readings.
_NO_READING = re.compile(r"field|.*(?:covariance|bias|offset|error).*")
_ROS_UNITS = {"magnetic_field": "T", "linear_acceleration": "m/s2", "angular_velocity": "rad/s"}
# Fewest rows that show which columns vary.
_FEWEST_ROWS = 20
# Number of choices in a hint.
_MOST_CHOICES = 3
_NUMBERED_AXES = {"0": "x", "1": "y", "2": "z"}
#: Common part of the names of a magnetometer's columns.
MAGNETOMETER_STEM = re.compile(
    r"mag|compass|flux|field|(?<![a-z])(?:[mb]|m-?r)$|"
    r"hmc5|qmc5|lis[23]mdl|iis2mdc|ak\d{4}|rm3100|mmc5|bmm[13]|ist83|mlx9039"
)
#: Common part of the names of an accelerometer's columns.
ACCELEROMETER_STEM = re.compile(r"acc|(?<![a-z])(?:[af]|a-?r)$")
#: Common part of the names of a gyroscope's columns.
GYROSCOPE_STEM = re.compile(r"gyr|omega|angular|(?<![a-z])rate|(?<![a-z])(?:[gw]|g-?r)$")


class NoMagnetometerError(ConfigError):
    """No columns can be those of a magnetometer."""

    def __init__(self, message: str, sensors: frozenset[str]) -> None:
        self.sensors = sensors
        """Sensors that have columns in the file: ``accelerometer``, ``gyroscope``."""
        super().__init__(message)


def unit_of(headers: Sequence[str]) -> FieldUnit | None:
    """Return the unit of a field in headers; None without one.

    Raises
    ------
    ConfigError
        When they have different units.
    """
    units = {FIELD_WORDS[word] for header in headers if (word := name_and_unit(header)[1]) in FIELD_WORDS}
    if len(units) > 1:
        raise ConfigError(f"the header says {', '.join(headers)}: different units; say which one with --unit")
    return next(iter(units), None)


def unit_in_text(text: str) -> FieldUnit | None:
    """Return the unit that a text above a table names for the field, as in "Magnetic field in uT"; None without one."""
    words = _IN_WORDS.findall(text)
    units = {FIELD_WORDS[word] for written in words if (word := unit_word(written)) in FIELD_WORDS}
    return units.pop() if len(units) == 1 else None


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
    first, second, third = some_columns(requested, headers, width, (3,), option=option)
    return first, second, third


def some_columns(
    requested: str, headers: Sequence[str], width: int, counts: Sequence[int], *, option: str = "--columns"
) -> tuple[int, ...]:
    """Return the indexes of as many columns as `counts` allows; see `named_columns`."""
    names = [name.strip() for name in next(csv.reader([requested], skipinitialspace=True), [])]
    if len(names) not in counts:
        words = " or ".join({1: "one", 2: "two", 3: "three"}[count] for count in counts)
        raise ConfigError(f"{option} {requested}: {len(names)} columns; give {words}, for example mx,my,mz or 5,6,7")
    places = tuple(column_index(name, headers, width, option=option) for name in names)
    if len(set(places)) != len(places):
        raise ConfigError(f"{option} {requested}: a column is named twice")
    return places


def guessed_columns(
    headers: Sequence[str], places: Sequence[int], index: int | None = None, rows: Sequence[Sequence[str]] = ()
) -> tuple[int, ...]:
    """Return the indexes of the columns that must be the magnetometer's: three, or two of a compass with two axes.

    Parameters
    ----------
    headers
        Names of the columns; empty without a header.
    places
        Indexes of the columns.
    index
        Index of a column that counts the rows.
    rows
        First rows of cells, with which hints are tried.

    Raises
    ------
    ConfigError
        When more than one triple is possible; the message lists the choices that can be read.
    NoMagnetometerError
        When none is.
    """
    vectors = axis_vectors(headers)
    triples = {stem: places for stem, places in vectors.items() if len(places) == 3}
    magnetic = {stem: triple for stem, triple in triples.items() if is_magnetometer(stem)} or {
        stem: triple
        for stem, triple in triples.items()
        if FIELD_WORDS.get(name_and_unit(headers[triple[-1]])[1], FieldUnit.COUNTS) is not FieldUnit.COUNTS
    }
    if len(magnetic) > 1:  # `field_error` or `mag_covariance` beside `magnetometer` is no second magnetometer.
        by_more = {s: triple for s, triple in magnetic.items() if is_magnetometer(_NO_READING.sub("", s))}
        magnetic = by_more or magnetic
        if len(rows) >= _FEWEST_ROWS:  # One that is written twice is no second one either.
            magnetic = {str([[row[place] for place in triple] for row in rows]): triple for triple in magnetic.values()}
    if len(magnetic) == 1:
        return next(iter(magnetic.values()))
    if len(magnetic) > 1:
        raise ConfigError(f"more than one magnetometer{column_hint(headers, places, rows, magnetic.values())}")
    if "" in triples and _may_be_a_field(headers, triples[""]):
        return triples[""]
    others = [place for place, name in enumerate(headers) if seconds_of(name) is None and place != index]
    pairs = {stem: places for stem, places in vectors.items() if len(places) == 2}
    planar = [pair for stem, pair in pairs.items() if is_magnetometer(stem) or list(pair) == others]
    if len(planar) == 1:
        return planar[0]
    bare = places if len(places) == 3 else [place for place in places if place != index]
    if len(bare) == 3 and not triples:
        return bare[0], bare[1], bare[2]
    if not headers and len(varying := _readings(places, rows)) == 3:
        return varying
    description = f"the columns are {', '.join(headers)}" if headers else f"no header and {len(places)} columns"
    hint = column_hint(headers, places, rows)
    message = f"cannot tell which columns are the magnetometer: {description}{hint}"
    stems = {"accelerometer": ACCELEROMETER_STEM, "gyroscope": GYROSCOPE_STEM}
    raise NoMagnetometerError(
        message, frozenset(name for name, stem in stems.items() if any(map(stem.search, triples)))
    )


def is_magnetometer(name: str) -> bool:
    """Return whether a name is that of a magnetometer, and not that of another sensor."""
    others = ACCELEROMETER_STEM.search(name.lower()) or GYROSCOPE_STEM.search(name.lower())
    return MAGNETOMETER_STEM.search(name.lower()) is not None and not others


def is_sensor(name: str) -> bool:
    """Return whether a name is that of a magnetometer, an accelerometer or a gyroscope."""
    patterns = (MAGNETOMETER_STEM, ACCELEROMETER_STEM, GYROSCOPE_STEM)
    return any(pattern.search(name.lower()) for pattern in patterns)


def _may_be_a_field(headers: Sequence[str], places: Sequence[int]) -> bool:
    """Return whether no column is in a unit of another sensor."""
    units = {name_and_unit(headers[place])[1] for place in places}
    return not units & (ACCELERATION_WORDS.keys() | RATE_WORDS.keys()) - FIELD_WORDS.keys()


def column_hint(
    headers: Sequence[str],
    places: Sequence[int],
    rows: Sequence[Sequence[str]],
    triples: Iterable[tuple[int, ...]] | None = None,
) -> str:
    """Return a hint with the triples whose columns can be read: numbers that neither stand still nor only rise.

    Parameters
    ----------
    triples
        Candidates; by default those of the header that are no known sensor's, without any the columns of numbers.
    """
    by_stem = axis_triples(headers)
    if triples is None and by_stem:
        triples = [triple for stem, triple in by_stem.items() if not is_sensor(stem)]
    elif triples is None:
        numbers = [place for place in places if _may_be_readings([row[place] for row in rows])]
        step = 1 if len(numbers) % 3 else 3
        triples = zip(numbers[::step], numbers[1::step], numbers[2::step], strict=False)
    choices: list[str] = []
    for triple in triples:
        columns = [[row[place] for row in rows if place < len(row)] for place in triple]
        names = ",".join(headers[place] if headers else str(place + 1) for place in triple)
        with suppress(ConfigError):
            if all(map(_may_be_readings, columns)) and named_columns(names, headers, len(headers) or len(rows[0])):
                choices.append(f"--columns '{names}'" if " " in names else f"--columns {names}")
    return f"; choose {' or '.join(choices[:_MOST_CHOICES])}" if choices else ""


def _readings(places: Sequence[int], rows: Sequence[Sequence[str]]) -> tuple[int, ...]:
    """Return the columns of numbers that neither stand still nor only rise; none if a column of text changes."""
    columns = {place: [row[place] for row in rows] for place in places}
    texts = [cells for cells in columns.values() if not any(map(is_number, cells)) and len(set(cells)) > 1]
    if len(rows) < _FEWEST_ROWS or texts:
        return ()
    return tuple(place for place, cells in columns.items() if _may_be_readings(cells))


def _may_be_readings(cells: Sequence[str]) -> bool:
    numbers = [float(cell) for cell in cells if is_number(cell)]
    steps = {after - before for before, after in pairwise(numbers)}
    return 0 < len(numbers) == len(cells) and (len(numbers) < 3 or min(steps) < 0.0)


def axis_triples(headers: Sequence[str]) -> dict[str, tuple[int, int, int]]:
    """Return the columns of x, y and z by the common part of their names, if all three exist once."""
    whole = {stem: axes for stem, axes in _columns_of_axes(headers).items() if sorted(axes) == ["x", "y", "z"]}
    for axes in whole.values():
        in_units = {axis: [p for p in axes[axis] if name_and_unit(headers[p])[1] in _SIZED] for axis in axes}
        if all(len(places) == 1 for places in in_units.values()):
            axes |= in_units  # perhaps beside the same in counts
    return {
        stem: (axes["x"][0], axes["y"][0], axes["z"][0])
        for stem, axes in whole.items()
        if all(len(places) == 1 for places in axes.values())
    }


def axis_vectors(headers: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Return the columns of `axis_triples`, and those of x and y alone, by the common part of their names."""
    pairs = {
        stem: (axes["x"][0], axes["y"][0])
        for stem, axes in _columns_of_axes(headers).items()
        if {axis: len(places) for axis, places in axes.items()} == {"x": 1, "y": 1}
    }
    return {**axis_triples(headers), **pairs}


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
        if (parts := stem_and_axis(header)) is not None:
            columns.setdefault(parts[0], {}).setdefault(parts[1], []).append(index)
    return columns


def stem_and_axis(header: str) -> tuple[str, str] | None:
    """Return the part of a header without its axis and unit, and the axis: x, y or z; None without an axis.

    Examples
    --------
    >>> stem_and_axis("imu_mx"), stem_and_axis("magADC[0]"), stem_and_axis("Shimmer_Mag_Z_CAL")
    (('imu_m', 'x'), ('magadc', 'x'), ('cal shimmer_mag', 'z'))
    """
    name = name_and_unit(header)[0][-LONGEST_NAME:]
    parts = next((matched.groupdict() for pattern in _AXES if (matched := pattern.match(name))), None)
    if parts is None:
        return None
    stem = " ".join(parts[key] for key in ("rest", "stem", "sensor") if parts.get(key))
    return stem, _NUMBERED_AXES.get(parts["axis"], parts["axis"])


def name_and_unit(header: str) -> tuple[str, str]:
    """Return name and unit of a header in lower case; the unit is empty without one.

    Examples
    --------
    >>> name_and_unit("Mag X (µT)"), name_and_unit("UncalMagXMicroT"), name_and_unit("magnetometer_ga[0]")
    (('mag x', 'ut'), ('uncalmagx', 'microt'), ('magnetometer[0]', 'ga'))
    """
    written = header.strip()
    if len(written) > LONGEST_NAME:
        return written.lower(), ""
    bracketed = _BRACKETED.match(written)
    if indexed := _INDEXED.match(written):
        name, unit = name_and_unit(indexed["name"])
        return f"{name}{indexed['index'].lower()}", unit
    if bracketed:
        return bracketed["name"].strip().lower(), unit_word(bracketed["unit"])
    suffixed = _SUFFIXED.match(written) or _GLUED.match(written)
    if suffixed and is_unit(suffixed["unit"]):
        return suffixed["name"].lower(), unit_word(suffixed["unit"])
    return written.lower(), ""


def add_ros_units(headers: Sequence[str]) -> tuple[str, ...]:
    """Return headers with the units of ROS's messages, which are SI's, if a column is from a message's header."""
    if not any("header.stamp" in header or "header.frame_id" in header for header in headers):
        return tuple(headers)
    return tuple(f"{header} [{matched}]" if (matched := _ros_unit(header)) else header for header in headers)


def _ros_unit(header: str) -> str:
    return next((unit for name, unit in _ROS_UNITS.items() if re.search(rf"\b{name}\.[xyz]$", header)), "")


def is_unit(word: str, *, other: bool = False) -> bool:
    """Return whether a word is a unit of a sensor's readings; with `other`, or of another column in a row of units."""
    bare = word.strip()[1:-1] if word.strip().startswith(("[", "(")) else word.strip()
    return unit_word(bare) in _UNIT_WORDS or (other and bare.lower() in _OTHER_UNITS)


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


_UNITS_S = {
    **dict.fromkeys(("s", "sec", "secs", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "usecs", "micros", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), 1e-9),
}
# Words of a name beside the word for time itself.
_BESIDE = frozenset(
    re.split(
        " ",
        "rtc gps utc unix system sys host log logging sensor imu mag sample local boot since reboot start epoch of in "
        "cal txt header device android arduino mcu relative",
    )
)
_TIMES = frozenset(("time", "timestamp", "stamp", "t", "ts", "datetime", "clock", "elapsed", "zeit"))
_NAME_WORD = re.compile(r"[A-Zµμ]?[a-zµμ]+|[A-Z]+(?![a-z])|\d+")
_IN_BRACKETS = re.compile(r"[(\[].*$")


def seconds_of(header: str) -> float | None:
    """Return the unit of a time column in seconds, NaN if its name has none; None if its name is not that of a time.

    Examples
    --------
    >>> seconds_of("time_s"), seconds_of("Timestamp [ms]"), seconds_of("t"), seconds_of("temperature")
    (1.0, 0.001, nan, None)
    """
    words = [word.lower() for word in _NAME_WORD.findall(_IN_BRACKETS.sub(lambda unit: unit[0].lower(), header))]
    if "timestamp" in words or all(word in _UNITS_S or word in _TIMES or word in _BESIDE for word in words):
        unit_s = next((_UNITS_S[word] for word in reversed(words) if word in _UNITS_S), math.nan)
        if _TIMES & set(words) or (len(words) == 1 and not math.isnan(unit_s) and len(words[0]) > 1):
            return unit_s
    return None
