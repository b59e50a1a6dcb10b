"""What readers of code are told of an instruction, against the texts of capstone.

All encodings with random fields and random halfwords are compared, in an IT block and outside. Which instructions are
defined, and which registers they write, `test_decode` compares.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest

from hiltest.virtual.core.decoder import decode, decode_first
from hiltest.virtual.core.library import lib
from hiltest.virtual.program.instruction_text import instruction_text

from .decoder import decode as decode_fields
from .decoder import instances, operation_name, random_instructions

ADDRESS = 0x1002
SP, PC, NONE = 13, 15, lib.NO_REGISTER
REGISTERS = {f"r{number}": number for number in range(16)} | {
    "sb": 9,
    "sl": 10,
    "fp": 11,
    "ip": 12,
    "sp": SP,
    "lr": 14,
    "pc": PC,
}
IT_OF_ONE = b"\x18\xbf"  # IT NE

OWN_CONDITION = re.compile(r"cbn?z .*|b(eq|ne|hs|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)(\.w)? .*")
# The first that fits counts.
FLOWS = {
    "RETURN": r"bx lr|mov pc, lr|pop.*\bpc\}|ldr(\.w)? pc, \[sp\](, #.*)?|ldm(ia)?(\.w)? sp!, .*\bpc\}",
    "LITERAL": r"ldr\.w pc, \[pc(, #.*)?\]",
    "TABLE": r"tb[bh] .*|ldr\.w pc, \[\w+, \w+, lsl #2\]",
    "POINTER_CALL": r"blx .*",
    "CALL": r"bl #.*",
    "JUMP": rf"b(\.w)? #.*|mov pc, pc|{OWN_CONDITION.pattern}",
    "POINTER": r"bx .*|(mov|add|ldr(\.w)?) pc, .*|ldm.*\bpc\}|pop.*\bpc\b.*",
    "ON": r".*",
}
ENTRY_SIZES = {"tbb": 1, "tbh": 2, "ldr.w": 4}

NUMBER = r"#(-?(?:0x)?[0-9a-f]+)"
ADDED = re.compile(rf"(add|sub)[sw]?(?:\.w)? (\w+), (?:(\w+), )?{NUMBER}")
ADDED_PC = re.compile(r"add (\w+), pc")
MOVED = re.compile(r"movs?(?:\.w)? (\w+), (\w+)")
ADDED_TO_STACK = re.compile(r"(add|sub)(s|w)?(\.w)? sp, (sp, )?\w+(, \w+ #\d+|, rrx)?")
BEHIND = re.compile(rf"(?!v).*\[(\w+)\], {NUMBER}")  # post-indexed
BEFORE = re.compile(rf".*\[(\w+), {NUMBER}\]!")
LISTED = re.compile(r"(v?push|v?pop|[vf]?(?:ld|st)m\w*)(?:\.w|\.\d\d)? (?:(\w+)!, )?\{(.*)\}")


class Change(NamedTuple):
    """How one register changes, see struct machine_instruction."""

    result: int = NONE
    base: int = NONE
    number: int = 0
    is_sum: bool = False


def change(text: str, writes: int) -> Change:
    """Read a change from a text, outside an IT block."""
    added = added_number(text)
    if re.match(r"msr (msp|psp|control), ", text):
        return Change(SP)
    if writes >> SP & 1 and added.result != SP:
        return Change(SP, SP if ADDED_TO_STACK.fullmatch(text) else NONE)
    return added


def added_number(text: str) -> Change:
    """Read which register becomes another one plus a number."""
    if match := ADDED.fullmatch(text):
        number = int(match[4], 0)
        base = REGISTERS[match[3] or match[2]]
        if base != PC:
            return Change(REGISTERS[match[2]], base, number if match[1] == "add" else -number, True)
    elif match := ADDED_PC.fullmatch(text):
        return Change(REGISTERS[match[1]], REGISTERS[match[1]], ADDRESS + 4, True)
    elif (match := MOVED.fullmatch(text)) and PC not in (REGISTERS[match[1]], REGISTERS[match[2]]):
        return Change(REGISTERS[match[1]], REGISTERS[match[2]], 0, True)
    elif match := BEHIND.fullmatch(text) or BEFORE.fullmatch(text):
        return Change(REGISTERS[match[1]], REGISTERS[match[1]], int(match[2], 0), True)
    elif (match := LISTED.fullmatch(text)) and (match[2] or match[1].endswith(("push", "pop"))):
        base = REGISTERS[match[2] or "sp"]
        number = sum(8 if name[0] == "d" else 4 for name in match[3].split(", "))
        number += 4 if match[1].endswith("x") else 0  # FLDMX and FSTMX move the base by a word more
        return Change(base, base, -number if match[1].endswith(("push", "db", "dbx")) else number, True)
    return Change()


def expected(text: str, writes: int, in_it_block: bool) -> dict[str, Any]:
    """Read from a text what is to be decoded."""
    flow = next(flow for flow, pattern in FLOWS.items() if re.fullmatch(pattern, text))
    target = 0
    if text == "mov pc, pc":
        target = ADDRESS + 4  # the PC reads as that
    elif flow in ("JUMP", "CALL"):
        target = int(text.rpartition("#")[2], 16)
    elif flow == "LITERAL":
        offset = re.search(NUMBER, text)
        target = (ADDRESS + 4 & ~3) + (int(offset[1], 0) if offset else 0)
    changed = change(text, writes)
    if in_it_block and changed.is_sum:
        changed = changed._replace(is_sum=False)
    return changed._asdict() | {
        "flow": getattr(lib, f"FLOW_{flow}"),
        "target": target,
        "entry_size": ENTRY_SIZES[text.split()[0]] if flow == "TABLE" else 0,
        "conditional": OWN_CONDITION.fullmatch(text) is not None and not in_it_block,
        "in_it_block": in_it_block,
        "begins_it_block": re.match(r"it[te]* ", text) is not None,
    }


def trials(of_each: int, pairs: int) -> Iterator[tuple[str, bytes, Any, Any]]:
    """Yield the text, the bytes, and both decoded forms of defined instructions, outside IT blocks and inside."""
    for source in (instances(of_each, seed=5), random_instructions(pairs, seed=6)):
        for first, second in source:
            code = struct.pack("<2H", first, second)
            text = instruction_text(ADDRESS, code)
            for it_state in (0, 0x18):
                fields = decode_fields(ADDRESS, first, second, it_state)
                if text == ".unknown" or operation_name(fields) in ("UNDEFINED", "NO_COPROCESSOR"):
                    continue
                if it_state:
                    _, described = decode(ADDRESS - 2, IT_OF_ONE + code[: fields.size])
                else:
                    described = decode_first(ADDRESS, code)
                yield text, code[: fields.size], fields, described


@pytest.mark.parametrize(("of_each", "pairs"), [(20, 3_000), pytest.param(600, 300_000, marks=pytest.mark.ci)])
def test_readers_of_code_are_told_what_capstone_says(of_each: int, pairs: int) -> None:
    differences: dict[str, str] = {}
    for text, code, fields, described in trials(of_each, pairs):
        answer = expected(text, fields.core_writes, bool(fields.in_it_block))
        answer |= {"address": ADDRESS, "size": len(code), "writes": fields.core_writes}
        for field, value in answer.items():
            decoded = getattr(described, field)
            if decoded != value:
                place = f"{field} of {operation_name(fields)}"
                differences[place] = f"{code.hex()} {text}: {decoded}, expected {value}"
    assert list(differences.values()) == []
