"""Debug information is hostile until parsed: whatever is damaged, a path is found or refused, and nothing hangs."""

from __future__ import annotations

import random
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import Any

import pytest
from elftools.elf.elffile import ELFFile

from hiltest.errors import ConfigError
from hiltest.interfaces.variables import Variables
from hiltest.virtual.program.elf import FirmwareImage

from .compiled import compile_c
from .test_variables import SOURCE

PATHS = (
    "calibration.hard_iron[AXIS_Y]",
    "app.part[1].rates",
    "first.next->value",
    "sample::count",
    "nothing",
    "*latest",
)
WALL_LIMIT_S = 20  # for what takes a tenth of a second
EXAMPLES = 250


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> bytes:
    folder = tmp_path_factory.mktemp("damaged")
    return compile_c(require_tool("arm-none-eabi-gcc"), folder, SOURCE, "-gdwarf-4").read_bytes()


class Hung(BaseException):
    """Not done in time; nothing that the tests call takes it for an error of the parser."""


@contextmanager
def within_wall_limit() -> Iterator[None]:
    """Turn a hang into a failure."""

    def late(*_: object) -> None:
        raise Hung(f"not done within {WALL_LIMIT_S} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(WALL_LIMIT_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def outcomes(content: bytes) -> list[str]:
    """Return what becomes of every path: found, or refused."""
    with within_wall_limit():
        variables, results = Variables(FirmwareImage(content)), []
        for path in PATHS:
            try:
                variables.place(path)
                results.append("found")
            except ConfigError as error:
                results.append("damaged" if "is damaged" in str(error) else "refused")
        return results


def debug_sections(content: bytes) -> dict[str, tuple[int, int]]:
    sections = ELFFile(BytesIO(content)).iter_sections()
    return {
        section.name: (section.header.sh_offset, section.header.sh_size)
        for section in sections
        if "debug" in section.name
    }


def test_it_is_whole_to_begin_with(content: bytes) -> None:
    assert outcomes(content) == ["found", "found", "found", "found", "refused", "found"]


@pytest.mark.slow
def test_bytes_that_are_wrong_are_refused_or_make_no_difference(content: bytes) -> None:
    sections = debug_sections(content)
    chosen = random.Random(18)
    observed: set[str] = set()
    for number in range(EXAMPLES):
        damaged = bytearray(content)
        offset, size = sections[(".debug_info", ".debug_abbrev", ".debug_info", ".debug_str")[number % 4]]
        for _ in range(chosen.choice([1, 1, 4, 60])):
            damaged[offset + chosen.randrange(size)] = chosen.choice([0, 0xFF, 0x7F, chosen.randrange(256)])
        observed |= set(outcomes(bytes(damaged)))
    assert observed == {"found", "refused", "damaged"}


def test_sections_that_are_cut_are_refused_or_make_no_difference(content: bytes) -> None:
    for offset, size in debug_sections(content).values():
        for share in (0.0, 0.1, 0.5, 0.99):
            begin = offset + int(share * size)
            outcomes(content[:begin] + bytes(offset + size - begin) + content[offset + size :])


def entries(content: bytes) -> Iterator[tuple[Any, int]]:
    """Yield the entries with where the file has `.debug_info`."""
    elf = ELFFile(BytesIO(content))
    offset = elf.get_section_by_name(".debug_info").header.sh_offset
    for unit in elf.get_dwarf_info().iter_CUs():
        for entry in unit.iter_DIEs():
            yield entry, offset


def pointed_at(content: bytes, tag: str, attribute: str, where: Callable[[Any], int]) -> bytes:
    """Return a copy in which a reference of every entry of a tag leads to `where`."""
    changed = bytearray(content)
    count = 0
    for entry, begin in entries(content):
        if entry.tag == tag and attribute in entry.attributes:
            at = begin + entry.attributes[attribute].offset
            changed[at : at + 4] = (where(entry) - entry.cu.cu_offset).to_bytes(4, "little")
            count += 1
    assert count
    return bytes(changed)


@pytest.mark.parametrize(
    ("tag", "attribute"),
    [
        ("DW_TAG_typedef", "DW_AT_type"),
        ("DW_TAG_array_type", "DW_AT_type"),
        ("DW_TAG_structure_type", "DW_AT_sibling"),
        ("DW_TAG_subprogram", "DW_AT_sibling"),
        ("DW_TAG_enumeration_type", "DW_AT_sibling"),
        ("DW_TAG_member", "DW_AT_type"),
        ("DW_TAG_volatile_type", "DW_AT_type"),
    ],
)
@pytest.mark.parametrize("back", ["itself", "the first"])
def test_entries_that_lead_in_a_circle_end(content: bytes, tag: str, attribute: str, back: str) -> None:
    def where(entry: Any) -> int:
        return int(entry.offset if back == "itself" else entry.cu.cu_die_offset)

    outcomes(pointed_at(content, tag, attribute, where))


def test_a_struct_that_contains_itself_is_refused(content: bytes) -> None:
    structs = [entry.offset for entry, _ in entries(content) if entry.tag == "DW_TAG_structure_type"]
    damaged = pointed_at(
        content,
        "DW_TAG_member",
        "DW_AT_type",
        lambda member: max(struct for struct in structs if struct < member.offset),
    )
    assert "damaged" in outcomes(damaged)
