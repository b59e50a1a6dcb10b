"""Programs that others wrote for the FRDM-K64F do what their README says, on the stock files."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.k64f import VirtualK64F

FOREIGN = Path(__file__).parents[3] / "shared/data/foreign"


@dataclass(frozen=True, slots=True)
class Program:
    """What a program must do.

    Attributes
    ----------
    name : str
    within_s : float
        Virtual time in which all of it must have come.
    talk : tuple of (str, str)
        A regular expression that must come on UART0, behind the one before, and what is sent then.
    """

    name: str
    within_s: float
    talk: tuple[tuple[str, str], ...]


def says(name: str, within_s: float, *texts: str) -> Program:
    """A program that says these texts in order, and is told nothing."""
    return Program(name, within_s, tuple((re.escape(text), "") for text in texts))


PROGRAMS = [
    says(
        "sdk_crc", 0.1, "CRC-16 CCIT FALSE: 0x29b1\r\n", "CRC-16 MAXIM: 0x44c2\r\n", "CRC-16 KERMIT: 0x2189\r\n",
        "CRC-32: 0xcbf43926\r\n", "CRC-32 POSIX: 0x765e7680\r\n",
    ),
    Program("sdk_rnga_random", 0.2, (
        (r"(Random\[\d\] = 0x[0-9A-F]+\s+){10}\s*Press any key", " "), (r"(Random\[\d\] = 0x[0-9A-F]+\s+){10}", ""),
    )),
    says(
        "sdk_edma_memory_to_memory", 0.1, "Destination Buffer:\r\n0\t0\t0\t0", "transfer example finish.",
        "Destination Buffer:\r\n1\t2\t3\t4",
    ),
    says(
        "sdk_flash_pflash", 0.2, "Flash is UNSECURE!", "Successfully Erased Sector 0xfe000 -> 0xff000",
        "Successfully Programmed and Verified Location 0xfe000 -> 0xfe010", "End of PFlash Example",
    ),
    Program("riot_hwrng", 1.0, (
        ("Press s to start test", "s\n"), (r"generating 3 random byte\(s\)\s+Got:( 0x[0-9a-f]{2}){3}\s", ""),
    )),
]  # fmt: skip


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_a_program_of_others_says_what_it_should(program: Program) -> None:
    elf = FOREIGN / f"{program.name}.elf"
    if not elf.is_file():
        assert not os.environ.get("HILTEST_REQUIRE_TOOLS"), f"{elf} is missing, and HILTEST_REQUIRE_TOOLS is set"
        pytest.skip(f"{elf} is not there")
    board = VirtualK64F(elf)
    said = ""
    for expected, answer in program.talk:
        said = after(board, program.within_s, said, expected)
        board.uart0.host_write(answer.encode())


def after(board: VirtualK64F, until_s: float, said: str, expected: str) -> str:
    """Run until what is expected has been said; return what came behind it."""

    def found() -> bool:
        nonlocal said
        if board.uart0.host_waiting:
            said += board.uart0.host_read(board.uart0.host_waiting).decode("latin-1")
        return re.search(expected, said) is not None

    try:
        board.run_until(until_s, wake=found)
    except BoardFault as fault:  # a program that has ended stays in a loop
        if not str(fault).startswith("hang"):
            raise
    assert found(), f"{expected!r} did not come: {said!r}, {board.position()}"
    match = re.search(expected, said)
    assert match is not None
    return said[match.end() :]
