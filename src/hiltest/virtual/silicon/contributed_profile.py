"""Check of a contributed profile: its board, its signature, and the agreement of its rows with the measured clocks."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import asdict, dataclass, fields
from datetime import date
from pathlib import Path
from typing import Any

from hiltest.errors import ConfigError
from hiltest.json_files import shown
from hiltest.virtual.model.profile_file import measured_file
from hiltest.virtual.program.elf import FirmwareImage
from hiltest.virtual.silicon.measured_profile import PLACES, MeasuredProfile, solve

_SIGNED = re.compile(r"[^<>]*[^<>\s] <[^<>@\s]+@[^<>@\s]+>")
_CHIP = re.compile(r"[0-9a-f]{32}")
_LONGEST = 200


@dataclass(frozen=True, slots=True)
class MeasuredOn:
    """Table ``[board]`` of a measured profile."""

    name: str
    revision: str
    """Revision as printed on the board; the owner of the board fills in name and revision."""
    unique_id: str
    """Unique id of the chip."""
    core_clock_hz: int
    firmware: str
    build_id: str
    compiler: str
    """Compiler of the firmware that counted."""
    date: str
    """Date of the measurement in ISO 8601."""
    signed_off_by: str
    """``Name <address>`` of the person who measured the profile and contributes it under hiltest's licence."""


#: Fields that the owner fills in.
BY_HAND = {
    "name": "the board, as printed on it: FRDM-K64F",
    "revision": "its revision, as printed on it: E4",
    "signed_off_by": "Name <address>: I measured this profile on this board, and contribute it under hiltest's licence",
}


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Result of checking a file."""

    name: str
    """Name of the profile."""
    board: MeasuredOn | None
    """Table ``[board]``; None if it is incomplete."""
    objections: tuple[str, ...]
    """Reasons for rejection; empty if the file is accepted."""
    remarks: tuple[str, ...]
    """Deviations of the measurement from the model's rules, which do not prevent acceptance."""


def check(file: Path, image: FirmwareImage, sequences: Collection[str]) -> CheckResult:
    """Check the board and the signature of a measured profile, and whether its rows follow from its clocks.

    Parameters
    ----------
    image
        Shipped firmware with the sequences.
    sequences
        Names of all sequences.

    Raises
    ------
    ConfigError
        If the file is not a timing profile.
    """
    content, name, rows = measured_file(file)
    board, objections = _board(content.get("board", {}))
    clocks, missing = _clocks(content.get("measured", {}), sequences)
    objections += missing
    if board is not None:
        objections += _board_objections(board, name, image.build_id)
    remarks: tuple[str, ...] = ()
    if board is not None and not missing and board.build_id == image.build_id:
        again = solve(clocks["sram"], about(board), image)
        remarks = again.remarks
        objections += _differences(content, {row: rows[row] for row in content.get("cost", {})}, again)
    return CheckResult(name, board, tuple(objections), remarks)


def about(board: MeasuredOn) -> str:
    """Return the end of the source of each measured row."""
    return f"board {board.unique_id}, firmware build {board.build_id}"


def _board(table: Any) -> tuple[MeasuredOn | None, list[str]]:
    if not isinstance(table, dict) or not table:
        return None, ["there is no table [board]: measure again, because this version writes it"]
    values, objections = dict[str, Any](), list[str]()
    for field in fields(MeasuredOn):
        value = table.get(field.name, "")
        kind: type = int if field.name == "core_clock_hz" else str
        if isinstance(value, bool) or not isinstance(value, kind):
            expected = "a number" if kind is int else "a text"
            objections.append(f"board.{field.name}: must be {expected}, not {shown(value)}")
        elif isinstance(value, str) and (len(value) > _LONGEST or not value.isprintable()):
            objections.append(f"board.{field.name}: must be one line of at most {_LONGEST} printable characters")
        elif not value:
            by_hand = BY_HAND.get(field.name)
            objections.append(f"board.{field.name} is empty: {by_hand or 'measure again'}")
        values[field.name] = value
    return (None if objections else MeasuredOn(**values)), objections


def _board_objections(board: MeasuredOn, name: str, build_id: str) -> Iterator[str]:
    if not _CHIP.fullmatch(board.unique_id) or name != f"silicon-{board.unique_id}":
        yield f"{name} is not the profile of the chip {board.unique_id}; measure a real board, and keep the name"
    if board.build_id != build_id:
        yield f"measured with firmware build {board.build_id}, not {build_id}: flash the shipped one and measure again"
    if not _SIGNED.fullmatch(board.signed_off_by):
        yield f"board.signed_off_by: must be Name <address>, not {shown(board.signed_off_by)}"
    try:
        date.fromisoformat(board.date)
    except ValueError:
        yield f"board.date: must be a date such as 2026-11-26, not {shown(board.date)}"


def _clocks(table: Any, sequences: Collection[str]) -> tuple[dict[str, dict[str, int]], list[str]]:
    """Return the clocks of each sequence by place, and objections to them."""
    table = table if isinstance(table, dict) else {}
    objections = []
    for place in PLACES:
        clocks = table.get(place)
        if not isinstance(clocks, dict) or set(clocks) != set(sequences):
            objections.append(f"[measured.{place}] lacks clocks of the {len(sequences)} sequences: measure again")
        elif any(isinstance(clock, bool) or not isinstance(clock, int) or clock < 0 for clock in clocks.values()):
            objections.append(f"[measured.{place}]: clocks must be whole numbers, at least 0")
    return table, objections


def _differences(content: dict[str, Any], rows: dict[str, Any], again: MeasuredProfile) -> Iterator[str]:
    if content.get("base") != again.base.name:
        yield f"base is {shown(content.get('base'))}, but these clocks require {again.base.name}"
    for row in sorted(rows.keys() | again.rows.keys()):
        if rows.get(row) != again.rows.get(row):
            now = again.rows[row].value if row in again.rows else "no such row"
            yield f"cost.{row} does not follow from the clocks, which give {now}"


def board_lines(board: MeasuredOn) -> Iterator[str]:
    """Return table ``[board]`` as lines of TOML, with comments on fields that the owner fills in."""
    yield "[board]"
    for key, value in asdict(board).items():
        line = f"{key} = {value}" if isinstance(value, int) else f"{key} = {quote(value)}"
        yield f"{line}  # {BY_HAND[key]}" if key in BY_HAND and not value else line


def quote(text: str) -> str:
    """Return a text as a basic string of TOML."""
    if not text.isprintable():
        raise ConfigError(f"the board reports {shown(text)}, which is not printable text; flash it again")
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def filled_in(content: dict[str, Any]) -> dict[str, str]:
    """Return name and revision of the board in a measured profile, but not the signature, which is for its counts."""
    board = content.get("board")
    texts = {key: board[key] for key in ("name", "revision") if key in board} if isinstance(board, dict) else {}
    return {key: value for key, value in texts.items() if isinstance(value, str) and value.isprintable()}
