"""Lines that name their numbers: ``mx=1 my=2``, ``Mag (uT): [1, 2, 3]``, ``x 1 y 2 z 3 (µT)``, YAML, ``$VNMAG,1,2,3``.

A line is text and numbers in turn. The text before a number ends with the number's name, and the text behind it begins
with its unit. A number without a name belongs to the list of the one before.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from hiltest.interfaces.sensor_files.cells import TableRow
from hiltest.interfaces.sensor_files.columns import (
    LONGEST_NAME,
    axis_vectors,
    is_sensor,
    is_unit,
    name_and_unit,
    seconds_of,
    stem_and_axis,
)
from hiltest.interfaces.sensor_files.parsed_lines import Line
from hiltest.interfaces.sensor_files.times import time_or_nan
from hiltest.measurement.units import conversion

# A clock; a number, also behind the letter of its axis ("z-0.5"), but not in "m/s^2", "*5A" or "imu-1"; an address.
_VALUE = re.compile(
    r"((?:\d{4}-\d\d-\d\d[T ])?(?<!\d)\d{1,2}:\d\d:\d\d(?:[.,]\d{1,9})?Z?"
    r"|(?:(?<![\w.^*@])(?<!\w[-+])[-+]?(?:\d+(?:\.\d*)?|\.\d+)|(?<=\b[xyz])[-+]?\d+\.\d+)(?:e[-+]?\d+)?(?![\d_]|x[0-9a-f])"
    r"|(?<!\S)0x[0-9a-f]+(?!\S)|(?<![\w.])[-+]?(?:nan|inf)(?!\w))",
    re.IGNORECASE,
)
# The index in "magADC[0]: 1", which is no value; a sensor's in "MAG_X[2]: 1"; the name in 'Field X' of ESPHome, or
# of a Python dict.
_INDEX, _SENSOR_INDEX = re.compile(r"(?<=\w)\[(\d)\](?=\s*[:=])"), re.compile(r"_([XYZxyz])\[(\d)\](?=\s*[:=])")
_QUOTED = re.compile(r"[\"']([^\"']+)[\"'](?=[^\"'=]*$|\s*=\s*$)")
# A channel in the text of Zephyr's shell, whose value has no name: "type=11(magn_xyz) index=0 ... value=1ns, (".
_CHANNEL = re.compile(r"\b([a-z]\w*_(?:xyz|[xyz]))\b")
_TRAILING_UNIT = re.compile(
    r"[\s)\]}]*[(\[]?([^\s,;|=:()\[\]{}]+)(?![^\s,;|=:()\[\]{}])[)\]]?(?!\s*[=:])(.*)", re.DOTALL
)
# "Mag XYZ: 1, 2, 3", "( x y z ) = ( 1  2  3 )"; one axis behind a name is that of one number.
_XYZ = re.compile(r"[\s(_]*x[\s,/]*y[\s,/]*z[\s)]*$", re.IGNORECASE)
_AXIS_BEHIND = re.compile(r"(?:^|[\s_.:/-])[xyz]$")
_WORD = re.compile(r"[^\W\d_]{2,}")
_PLAIN = re.compile(r"[\w .%/°-]+")
_BLOCK = re.compile(r"(\s*)(?:- )?([\w/.-]+):\s*$")
_OPEN, _CLOSED = ("(", "[", "{", "<"), " \t\r\n,;|/)]}>-"
#: Name of the column with ROS's time.
ROS_TIME = "time [s]"
# Fewest lines with the same axes that are a log rather than a remark above a table.
_FEWEST = 2
# Name of a number before three readings, and fewest rows that show that it is no reading.
_COUNTER, _FEWEST_COUNTS = " counter", 20
# Most words of a line that names the sensor of the lines below it.
_LONGEST_HEADING = 3
# Bounds of memory and time for hostile files.
_MOST_SHAPES, _DEEPEST = 1000, 16


def _axes(sensor: str, unit: str, counts: float = 1.0) -> tuple[tuple[str, float], ...]:
    return tuple((f"{sensor}{axis}_{unit}", counts) for axis in "xyz")


# Names, and counts per unit, of the numbers behind a word: of PJRC's and Adafruit's sketches for MotionCal, and of
# VectorNav's sentences.
_SENTENCES = {
    "raw": (*_axes("a", "g", 8192.0), *_axes("g", "dps", 16.0), *_axes("m", "uT", 10.0)),
    "uni": (*_axes("a", "m/s2"), *_axes("g", "rad/s"), *_axes("m", "uT")),
    "vnmag": _axes("m", "gauss"),
    "vnmar": (*_axes("m", "gauss"), *_axes("a", "m/s2"), *_axes("g", "rad/s")),
}
_SENTENCES["vnimu"] = (*_SENTENCES["vnmar"], ("temperature_degC", 1.0), ("pressure_kPa", 1.0))
_SENTENCES["vnymr"] = (("yaw_deg", 1.0), ("pitch_deg", 1.0), ("roll_deg", 1.0), *_SENTENCES["vnmar"])
MOTION_CAL_NOTE = (
    "Lines with Raw: were read as MotionCal's: acceleration at 8192 counts for 1 g, rates at 16 for 1 deg/s, field at "
    "10 for 1 uT."
)


class _Group(NamedTuple):
    """Numbers with one name."""

    name: str
    places: list[int]
    """Places of the numbers among those of the line."""
    is_marked: bool
    """True if a mark stands between name and number: ``=``, ``:``, or a bracket."""


class NamedLines:
    """Reader of lines that name their numbers.

    Attributes
    ----------
    columns : tuple of str
        Names of the numbers in the first lines, with units in brackets; empty if these lines are something else.
    counters : set of str
        Names of numbers before three readings.
    word : str
        First word of the lines if it determines the names of their numbers; empty otherwise.
    """

    def __init__(self, first_lines: Sequence[Line]) -> None:
        self._shapes: dict[tuple[str, ...], tuple[tuple[int, str, float], ...]] = {}
        self._blocks: list[tuple[int, str]] = []
        self._heading = ""
        self.counters: set[str] = set()
        self.word = ""
        seen: Counter[str] = Counter()
        counters: dict[str, list[float]] = {}
        rows = 0
        for line in first_lines:
            values = self.values(line.text)
            seen.update(values.keys())
            for name in values.keys() & self.counters:
                counters.setdefault(name, []).append(time_or_nan(values[name]))
            rows += not values and len(_VALUE.findall(line.text)) > max(2, len(_WORD.findall(line.text)))
        readings = tuple(f"{name[: -len(_COUNTER)]}." for name, numbers in counters.items() if not _is_counter(numbers))
        often = [
            name
            for name, count in seen.items()
            if count >= min(_FEWEST, len(first_lines)) and not (readings and name.startswith(readings))
        ]
        self._axes = frozenset(often[place] for places in axis_vectors(often).values() for place in places)
        self._times = frozenset(name for name in often if seconds_of(name) is not None)
        is_log = sum(seen[name] for name in self._axes) > rows
        self.columns = tuple(often) if is_log else ()
        if self.columns and ros_stamp(dict.fromkeys(seen, "0")):
            self.columns = (ROS_TIME, *self.columns)
        self._first = next((name for name in seen if name in self._axes | self._times), "")
        self.others = 0

    def rows(self, lines: Iterable[Line]) -> Iterator[TableRow]:
        """Yield a row for the lines up to the next with an axis that the row already has."""
        record: dict[str, str] = {}
        number, arrived_s = 0, 0.0
        self.others, columns = 0, frozenset(self.columns)
        self._blocks.clear()
        self._heading = ""
        for line in lines:
            values = self.values(line.text)
            if not values.keys() <= columns:
                values = {name: value for name, value in values.items() if name in columns}
            again = values.keys() & record.keys()
            ends = (
                line.text.startswith("---")
                or not again.isdisjoint(self._axes)
                or any(record[name] != values[name] for name in again & self._times)
                or (self._first in values and self._first in self._axes and not self._axes.isdisjoint(record))
            )
            if ends and record:
                yield self._row(number, record, arrived_s)
                record = {}
            self.others += not values
            if values and not record:
                number, arrived_s = line.number, line.arrived_s
            record |= values
        if record:
            yield self._row(number, record, arrived_s)

    def values(self, text: str) -> dict[str, str]:
        """Return the numbers of a line by their names, the axes and times among them; empty without any."""
        if "[" in text:
            text = _INDEX.sub(r"_\1", _SENSOR_INDEX.sub(r"_\2.\1", text))
        if block := _BLOCK.match(text):
            self._close_blocks(len(block[1]))
            if len(self._blocks) < _DEEPEST:
                self._blocks.append((len(block[1]), block[2]))
        parts = _VALUE.split(text)
        if len(parts) == 1:
            heading = text.strip(" \t\r\n:=*-#")
            if is_sensor(heading) and len(heading.split()) <= _LONGEST_HEADING:
                self._heading = heading
            return {}
        if self._blocks:
            self._close_blocks(len(text) - len(text.lstrip()))
        shape = (*(name for _, name in self._blocks), "\n", self._heading, *parts[::2])
        names = self._shapes.get(shape)
        if names is None:
            names = self._named(parts)
            if len(self._shapes) < _MOST_SHAPES:
                self._shapes[shape] = names
        if names[:1] and names[0][2] != 1.0 and not all(map(_is_whole, parts[1::2])):
            return {}
        values = {
            name: value if scale == 1.0 else str(float(value) / scale)
            for place, name, scale in names
            for value in [parts[2 * place + 1]]
        }
        if (instance := values.get("i", "0")) != "0":  # ArduPilot's second compass
            return {name if seconds_of(name) else f"instance {instance}.{name}": values[name] for name in values}
        return values

    def _row(self, number: int, record: dict[str, str], arrived_s: float) -> TableRow:
        if ROS_TIME in self.columns:
            record[ROS_TIME] = ros_stamp(record)
        return TableRow(number, tuple([record.get(name, "") for name in self.columns]), arrived_s)

    def _close_blocks(self, indent: int) -> None:
        while self._blocks and self._blocks[-1][0] >= indent:
            self._blocks.pop()

    def _named(self, parts: Sequence[str]) -> tuple[tuple[int, str, float], ...]:
        """Return place, name and divisor of the numbers of a line that have a name."""
        groups, units = _groups(parts[::2])
        block = "".join(f"{name}." for _, name in self._blocks)
        channel = _CHANNEL.search("".join(parts[::2]))
        names: dict[int, str] = {}
        own_units: dict[int, str] = {}
        stem, axis, vector = "", "", list[int]()
        heading, unit_above = name_and_unit(self._heading)
        for group in groups:
            if len(group.places) == 2 and parts[2 * group.places[1]] == ":":
                group = group._replace(places=group.places[1:])  # Teleplot's "mag_x:TIME:VALUE"
            is_vector = len(group.places) == 3
            name, unit = name_and_unit(_XYZ.sub("", group.name) if is_vector else group.name)
            sentence = _SENTENCES.get(name.rpartition(" ")[2], ())
            if len(group.places) == len(sentence):
                self.word = self.word or name.rpartition(" ")[2]
                is_first = sentence is _SENTENCES[self.word]
                return tuple((place, *scale) for place, scale in zip(group.places, sentence, strict=True) if is_first)
            unit = unit or next((units[place] for place in reversed(group.places) if place in units), "")
            if not name and group.is_marked and channel:
                name = channel[1].removesuffix("_xyz")
            if is_vector and len(name) > 1 and conversion(group.name, "uT"):
                name, unit = "", group.name  # "mG: 1, 2, 3"
            parsed = stem_and_axis(name.replace("_xyz", ""))
            is_named = group.is_marked or (len(name) > 1 and is_sensor(name))
            if is_vector or (len(group.places) == 4 and is_sensor(name)):
                if not is_named or _AXIS_BEHIND.search(name):
                    continue
                name = _XYZ.sub("", name)
                called = [f"{name}.{letter}" if name else letter for letter in "xyz"]
                if not is_vector:  # "$PMAG,17,1,2,3"
                    called.insert(0, f"{name}{_COUNTER}")
                    self.counters.add(called[0])
            elif len(group.places) > 1 and (parsed is None or parts[2 * group.places[1]] == ","):
                continue  # "mx=34,59" has a comma as decimal sign, or two numbers
            elif not name:
                called = ["time"] if ":" in parts[2 * group.places[0] + 1] and not block else []
            elif parsed is None:
                name = name.rpartition("{")[2].lstrip()  # "RAW_IMU {time_usec : 1, xmag : 2"
                is_named = group.is_marked or seconds_of(group.name) is not None
                called = [name] if is_named and _PLAIN.fullmatch(name) else []
            else:
                # "Mag X: 1 Y: 2 Z: 3 uT": the name of the first axis is that of the others, and the unit of the last.
                follows = (axis, parsed[1]) in (("x", "y"), ("y", "z"))
                if follows and parsed[0] and stem != parsed[0] and stem.endswith(parsed[0]):
                    # "IMU mx=1 my=2": text stands before the first name.
                    names[vector[-1]] = names[vector[-1]].replace(stem, parsed[0])
                stem = stem if not parsed[0] and follows else parsed[0]
                axis, vector = parsed[1], [*(vector if follows else ()), group.places[0]]
                own_units |= dict.fromkeys((place for place in vector if unit and place not in own_units), unit)
                called = [f"{stem}.{axis}" if stem else axis]
            for place, own in zip(group.places, called, strict=False):
                is_bare = own in ("x", "y", "z") and not block
                names[place] = f"{heading}.{own}" if is_bare and heading else f"{block}{own}"
                if own_unit := unit or (unit_above if is_bare else ""):
                    own_units.setdefault(place, own_unit)
        written = {
            place: f"{name} [{own_units[place]}]" if place in own_units else name for place, name in names.items()
        }
        counts = Counter(written.values())  # a name that comes twice in a line has two meanings
        return tuple((place, name, 1.0) for place, name in written.items() if counts[name] == 1)


def _is_counter(numbers: Sequence[float]) -> bool:
    """Return whether numbers are counts, times or an address, because they only rise or never change."""
    steps = {after > before for before, after in pairwise(numbers)}
    return len(numbers) >= _FEWEST_COUNTS and (steps == {True} or len(set(numbers)) == 1)


def _groups(texts: Sequence[str]) -> tuple[list[_Group], dict[int, str]]:
    """Return the numbers between texts in groups, and the units behind numbers by their places."""
    groups: list[_Group] = []
    units: dict[int, str] = {}
    for place, text in enumerate(texts):
        ends = ")" in text or "]" in text
        if place:
            unit, text = _split_unit(text)
            ends = ends or bool(unit)
            if unit:
                units[place - 1] = unit
        if place == len(texts) - 1:
            break
        quoted = _QUOTED.search(text)
        bare = text.rstrip(" \t\"'")
        if bare.endswith("=") and (others := re.split(r"[,;|=]", bare.rstrip("= \t")))[1:]:
            bare = f"{others[-1].split()[-1] if others[-1].split() else ''}="  # "imu,board=a mx=" of InfluxDB
        written = quoted[1] if quoted else bare
        name = written.rstrip(" \t:=>-," + "".join(_OPEN)).lstrip("$" + _CLOSED + "".join(_OPEN))
        is_marked = bool(quoted) or bare.endswith((*_OPEN, ":", "=", ">"))
        name = name[-LONGEST_NAME:]
        if name or bare.endswith(_OPEN) or not groups:
            groups.append(_Group(name, [place], is_marked))
        elif ends and len(groups[-1].places) >= 3:
            groups.append(_Group("", [place], False))  # "mag = [1, 2, 3] uT, |m| = 4"
        else:
            groups[-1].places.append(place)
    return groups, units


def _split_unit(text: str) -> tuple[str, str]:
    """Split the text behind a number into the number's unit and the rest."""
    matched = _TRAILING_UNIT.match(text)
    if matched is None or (not is_unit(matched[1]) and matched[1] not in ("ns", "us", "ms")):
        return "", text
    if text.lstrip()[:1] in _CLOSED and matched[2].lstrip().startswith(_OPEN):
        return "", text  # "mag (1, 2, 3) g (4, 5, 6)"
    return matched[1], matched[2]


def _is_whole(number: str) -> bool:
    return number.lstrip("+-").isdecimal()


def ros_stamp(values: dict[str, str]) -> str:
    """Return the time of ROS's two parts of one, in seconds; empty without both."""
    for name, value in values.items():
        stem, _, last = name.rpartition(".")
        for part in ("nanosec", "nsecs"):
            parts = value, values.get(f"{stem}.{part}", "")
            if last in ("sec", "secs") and all(text.isdecimal() for text in parts):
                return f"{int(parts[0]) + 1e-9 * int(parts[1]):.9f}"
    return ""
