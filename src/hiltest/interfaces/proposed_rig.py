"""The text of a rig for firmware that is only known by its ELF, with guesses as comments."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from hiltest.interfaces.candidate_lines import line_candidates
from hiltest.interfaces.candidate_variables import variable_candidates
from hiltest.interfaces.candidates import ANGLES, Candidate, best_first, words_of
from hiltest.interfaces.quantities import Quantity
from hiltest.measurement.units import unit_words
from hiltest.virtual.program.elf import FirmwareImage, Symbol

#: Function that asks which of several candidates is meant, and returns its number.
Choose = Callable[[str, Sequence[str]], int]
Candidates = Mapping[Quantity, Sequence[Candidate]]

# Functions that identify the firmware; two of them, to exclude namesakes.
_OURS = frozenset({"command_identity", "command_calibrate", "command_collect", "command_read"})
_NXP = frozenset({"fRun_9DOF_GBY_KALMAN", "fRun_6DOF_GY_KALMAN", "fInvertMagCal", "feCompassNED", "fInitializeFusion"})
# Names of functions that are worth counting, and of those that only prepare, store or show results, or do other work.
_WORK = re.compile(
    r"\b(?:calibrat\w+|cal|fit|ellipsoid|iron|fusion|fuse|kalman|ekf|madgwick|mahony|ahrs|heading|e ?compass)\b"
)
_NO_WORK = re.compile(
    r"\b(?:init\w*|save|load|get|set|erase|print|reset|clear|read|write|send|to|from|adc\d*|clock|irc|osc|handler|irq"
    r"|start|stop|test|config\w*|is|free|acc\w*|gyro\w*|auto)\b"
)
_WAITS = re.compile(r"\b(?:wait\w*|sleep\w*|delay\w*|idle|yield|pause)\b")
_MOST_SHOWN = 6  # candidates of a quantity, which fit on a screen
_MOST_COUNTED = 8
_CALIBRATION = (Quantity.HARD_IRON, Quantity.INVERSE_SOFT_IRON)
_NOTE_COLUMN, _LONGEST_NOTE = 50, 120
_WORLD = ("field", "mounting", "turntable", "sensors", "procedure", "world")


class InterfaceKind(StrEnum):
    """Interface to firmware; the values are a rig's kinds."""

    FSFLK = "fsflk"
    TEXT = "text"
    MEMORY = "memory"


_DEVICE = """[device]
kind = "{}"
frame = "ned"        # not in an ELF: ned, android, windows or enu (docs/compass.md)
"""
_NXP_DEVICE = """start_s = 2.0
tumbles = 2
converge_s = 60.0    # time for the filter to find the gyroscope's offset
"""
_RELEASE = """
[device.fsflk]
release = "{}"        # 7, 5.00 or 4.22"""
_REAL_BOARD = """# The ELF is for another chip than the virtual board's, so the rig is for its own board.
[board]
kind = "real"
# port = "/dev/ttyACM0"    # or --port

[turntable]
kind = "operator"          # asks for each angle and waits for Enter
uncertainty_deg = 0.5      # divided circle, set and read by hand (k = 2)
tumble_s = 45.0"""
_NO_DEVICE = """# No name or text in the ELF is certainly a heading. Without a table [device], hiltest expects firmware
# with its own protocol. Describe the output of yours: docs/compass.md lists the kinds.
# [device]
# kind = "text\""""
_WORDS = {
    InterfaceKind.FSFLK: "packets of NXP's Sensor Fusion",
    InterfaceKind.TEXT: "printed lines",
    InterfaceKind.MEMORY: "variables by name",
}


@dataclass(frozen=True, slots=True)
class _Table:
    """Text of a table, empty without candidates, and whether it uses a heading."""

    text: str
    has_heading: bool


@dataclass(frozen=True, slots=True)
class Proposals:
    """Interfaces that an ELF's names and texts suggest."""

    speaks_our_protocol: bool
    kinds: tuple[InterfaceKind, ...]
    """Kinds that may give the heading, the surest first."""
    release: str
    """Release of NXP's Sensor Fusion; empty for other firmware."""
    lines: Candidates
    variables: Candidates
    """Candidates, best first."""
    functions: tuple[str, ...]
    """Functions that calibrate, fuse or compute a heading by their names, the largest first."""
    remark: str
    """Obstacle to reading all debug information; empty without one."""

    @property
    def base_rig(self) -> str:
        """Packaged rig that provides world, sensors and turntable: for NXP's shield, or for hiltest's."""
        return "nxp-fusion-agm01" if self.release else "text-compass"

    @property
    def found(self) -> int:
        """Number of names and texts that were found."""
        tables = (self.lines, self.variables)
        return len(self.functions) + sum(len(candidates) for table in tables for candidates in table.values())


def look_at(image: FirmwareImage) -> Proposals:
    """Search an ELF's symbols, texts and debug information. Damage to the latter becomes a remark."""
    variables, remark = variable_candidates(image)
    by_line, by_variable = best_first(line_candidates(image)), best_first(variables)
    names = {function.name for function in image.functions}
    is_nxp = len(names & _NXP) > 1
    kinds = {
        InterfaceKind.FSFLK: is_nxp,
        InterfaceKind.TEXT: Quantity.HEADING in by_line,
        InterfaceKind.MEMORY: Quantity.HEADING in by_variable,
    }
    if is_nxp:  # its variables are in hiltest's units
        by_variable = {
            quantity: [_set_own_unit(candidate) for candidate in several] for quantity, several in by_variable.items()
        }
    return Proposals(
        len(names & _OURS) > 1,
        tuple(kind for kind, may_be in kinds.items() if may_be),
        ("7" if "sfg" in image.symbols else "5.00") if is_nxp else "",
        by_line,
        by_variable,
        _functions(image),
        remark,
    )


def _set_own_unit(candidate: Candidate) -> Candidate:
    unit = "" if "int" in candidate.reason else candidate.meaning.quantity.unit
    return replace(candidate, meaning=replace(candidate.meaning, unit=unit))


def _functions(image: FirmwareImage) -> tuple[str, ...]:
    largest_first = sorted(image.functions, key=lambda function: -function.size)
    names = [function.name for function in largest_first if is_countable(function)]
    words = {name: " ".join(words_of(name)) for name in names}
    names_of_work = [
        name for name, its_words in words.items() if _WORK.search(its_words) and not _NO_WORK.search(its_words)
    ]
    return tuple(names_of_work[:_MOST_COUNTED])


def is_countable(function: Symbol) -> bool:
    """Return whether a function has code, and a name that is a key of a table."""
    return bool(function.size and re.fullmatch(r"[A-Za-z_]\w*", function.name, re.ASCII))


def is_wait(name: str) -> bool:
    """Return whether a function waits, by its name."""
    return bool(_WAITS.search(" ".join(words_of(name))))


def chosen_kind(proposals: Proposals, choose: Choose | None) -> InterfaceKind | None:
    """Return the interface: the surest one, or the user's choice; None if none gives a heading."""
    kinds = proposals.kinds
    if choose is None or len(kinds) < 2:
        return next(iter(kinds), None)
    return kinds[choose("Source of the heading", [_WORDS[kind] for kind in kinds])]


def rig_text(
    proposals: Proposals,
    kind: InterfaceKind | None,
    base: str,
    *,
    name: str,
    firmware: str | None,
    choose: Choose | None,
    machine: str | None = None,
) -> str:
    """Return the text of a rig, without functions whose cycles are counted.

    Parameters
    ----------
    base
        Text of the rig `Proposals.base_rig`, or of the rig of `machine`.
    name, firmware
        Name of the rig; path of the ELF from the rig's folder, None if only a real board runs it.
    choose
        Asks the user; None without a user: only sure candidates are used.
    machine
        Virtual board that the firmware is for; None for the FRDM-K64F.
    """
    remark = f"# Incomplete: {_legible(proposals.remark)}\n" if proposals.remark else ""
    tables = _WORLD if firmware is not None else [table for table in _WORLD if table not in ("world", "turntable")]
    world = [
        part.strip("\n")
        for part in base.split("\n\n")
        if re.search(rf"(?m)^\[\[?(?:{'|'.join(tables)})(?:\.parts\])?\]$", part)
    ]
    board = '[board]\nkind = "virtual"\n' + (f'machine = "{machine}"\n' if machine else "")
    board += f"firmware = {json.dumps(firmware, ensure_ascii=False)}"
    parts = [
        f"# {name}: proposed by hiltest from an ELF's names and texts. Guesses are comments, best first.\n"
        f"# World, field, turntable and sensors are those of rig {machine or proposals.base_rig}: "
        "replace them by your board's.\n"
        f"{remark}schema = 1\nname = {json.dumps(name)}\nseed = 1",
        *([_REAL_BOARD] if firmware is None else [board]),
        *_device(proposals, kind, choose),
        *world,
        '[limits]\n"heading.firmware.max" = { max = 2.0, unit = "deg" }      # your requirement',
    ]
    return "\n\n".join(parts) + "\n"


def cycles_text(functions: Sequence[str]) -> str:
    """Return the table ``[cycles]`` with the first of some functions; empty without one."""
    lines = [f"{function} = {json.dumps(function)}" for function in functions[:_MOST_COUNTED]]
    return "\n".join(["\n# Functions whose cycles are counted.", "[cycles]", *lines, ""]) if lines else ""


def _device(proposals: Proposals, kind: InterfaceKind | None, choose: Choose | None) -> list[str]:
    """Return the tables of ``[device]``, with unused ones as comments."""
    tables = {
        InterfaceKind.TEXT: _patterns(proposals.lines, choose if kind is InterfaceKind.TEXT else None),
        InterfaceKind.MEMORY: _values(proposals.variables, choose if kind is InterfaceKind.MEMORY else None),
    }
    device = _DEVICE.format(kind) + (_NXP_DEVICE if proposals.release else "")
    if kind is InterfaceKind.FSFLK:
        used = device + _RELEASE.format(proposals.release)
    elif kind is not None and tables[kind].has_heading:
        used = f"{device}\n{tables.pop(kind).text}"
    else:
        used = _NO_DEVICE
    others = [
        f'# {_WORDS[other].capitalize()}; with kind = "{other}", or in a list of kinds:\n{_comment_out(table.text)}'
        for other, table in tables.items()
        if table.text
    ]
    return [used, *others]


def _used_candidates(candidates: Candidates, choose: Choose | None) -> dict[Quantity, Candidate]:
    """Return the candidates that the rig uses, with their units: the sure ones, and the heading that the user chose.

    Angles without a unit have the heading's. A hard iron and its matrix are used together: either alone would be half
    a calibration.
    """
    sure = {quantity: several[0] for quantity, several in candidates.items() if _is_clear(several[0])}
    if choose is not None and Quantity.HEADING in candidates:
        sure.pop(Quantity.HEADING, None)
        if (heading := _chosen_heading(candidates[Quantity.HEADING][:_MOST_SHOWN], choose)) is not None:
            sure[Quantity.HEADING] = heading
    angle = sure[Quantity.HEADING].meaning.unit if Quantity.HEADING in sure else ""
    used = {
        quantity: _set_unit(candidate, angle if candidate.needs_unit else "")
        for quantity, candidate in sure.items()
        if quantity in ANGLES or not candidate.needs_unit
    }
    if any(quantity in candidates and quantity not in used for quantity in _CALIBRATION):
        used = {quantity: candidate for quantity, candidate in used.items() if quantity not in _CALIBRATION}
    return used


def _is_clear(candidate: Candidate) -> bool:
    """Return whether names and types leave no doubt; a soft iron may be the matrix or its inverse."""
    is_named = candidate.meaning.quantity is not Quantity.INVERSE_SOFT_IRON or "inv" in candidate.example.lower()
    return candidate.meaning.is_sure and not candidate.stated_type and is_named


def _chosen_heading(candidates: Sequence[Candidate], choose: Choose) -> Candidate | None:
    """Return the heading with its unit; the user is asked for those that the ELF leaves open."""
    number = 0
    if len(candidates) > 1 or not _is_clear(candidates[0]):
        options = [f"{candidate.example}  ({candidate.reason})" for candidate in candidates]
        number = choose("Which one is the heading?", [*options, "none of these"])
    if number == len(candidates):
        return None
    heading = candidates[number]
    units = [unit for unit in unit_words(Quantity.HEADING.unit) if unit != "degrees"] if heading.needs_unit else []
    return _set_unit(heading, units[choose(f"Unit of the heading in {heading.example}", units)] if units else "")


def _set_unit(candidate: Candidate, unit: str = "") -> Candidate:
    """Return a candidate with the given unit, its guessed one, or the quantity's own."""
    its_unit = unit or candidate.meaning.unit or candidate.meaning.quantity.unit
    return replace(candidate, meaning=replace(candidate.meaning, unit=its_unit))


def _entries(candidates: Candidates, choose: Choose | None) -> Iterator[tuple[Candidate, str, str]]:
    """Yield candidates, each with its comment sign and a note."""
    used = _used_candidates(candidates, choose)
    for quantity, several in candidates.items():
        for candidate in several[:_MOST_SHOWN]:
            is_used = quantity in used and candidate.written == used[quantity].written
            doubt = "" if quantity is not Quantity.INVERSE_SOFT_IRON or _is_clear(candidate) else "or its inverse?"
            entry = used[quantity] if is_used else _set_unit(candidate)
            if candidate.needs_unit and not (is_used and choose is not None and quantity is Quantity.HEADING):
                doubt = f"{entry.meaning.unit}? not stated"
            yield entry, "" if is_used else "# ", "; ".join(filter(None, (candidate.reason, doubt)))


def _values(candidates: Candidates, choose: Choose | None) -> _Table:
    """Return the table ``[device.memory.values]``."""
    lines, has_heading = [], False
    for candidate, comment, note in _entries(candidates, choose):
        parts = {"path": candidate.written, "unit": candidate.meaning.unit, "type": candidate.stated_type}
        inner = ", ".join(f"{key} = {json.dumps(text)}" for key, text in parts.items() if text)
        lines.append(_add_note(f"{comment}{candidate.meaning.quantity.key} = {{ {inner} }}", note))
        has_heading |= not comment and candidate.meaning.quantity is Quantity.HEADING
    return _Table("\n".join(["[device.memory.values]", *lines]) if lines else "", has_heading)


def _patterns(candidates: Candidates, choose: Choose | None) -> _Table:
    """Return the tables ``[device.text]`` and ``[device.text.values]``."""
    lines, units, has_heading = [], [], False
    for candidate, comment, note in _entries(candidates, choose):
        pattern = json.dumps(candidate.written) if "'" in candidate.written else f"'{candidate.written}'"
        lines.append(_add_note(f"  {comment}{pattern},", note))
        if candidate.meaning.unit:
            units.append(f'{comment}{candidate.meaning.quantity.key} = {{ unit = "{candidate.meaning.unit}" }}')
        has_heading |= not comment and candidate.meaning.quantity is Quantity.HEADING
    error = "# error = '^ERROR (?P<error>.*)'             # pattern of a line that reports an error"
    text = ["[device.text]", "patterns = [", *lines, "]", error, "", "[device.text.values]", *dict.fromkeys(units)]
    return _Table("\n".join(text) if lines else "", has_heading)


def _add_note(line: str, note: str) -> str:
    return f"{line:<{_NOTE_COLUMN}}  # {_legible(note)}"


def _legible(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in text)[:_LONGEST_NOTE]


def _comment_out(text: str) -> str:
    """Return a table as a comment; existing comments stay as they are."""
    bare = re.sub(r"(?m)^( *)# ", r"\1", text)
    return "\n".join(f"# {line}".rstrip() for line in bare.splitlines())
