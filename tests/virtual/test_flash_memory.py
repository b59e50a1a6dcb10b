"""Commands of the flash module change the flash that code runs from, and a file keeps it from run to run."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build, follow, word
from .oracle import ran

DONE, COLLISION, ACCESS, PROTECTION, FAILED = 0x80, 0x40, 0x20, 0x10, 0x01
HEAD = """
volatile unsigned took, caught, first, second;
volatile unsigned char status;
__attribute__((noinline)) static void command(unsigned one, unsigned two, unsigned three) {
    BYTE(0x40020000) = 0x70;
    WORD(0x40020004) = one; WORD(0x40020008) = two; WORD(0x4002000C) = three;
    BYTE(0x40020000) = 0x80;
    // Asleep up to the interrupt of its end, which is masked.
    __asm__("cpsid i"); WORD(0xE000E100) = 1u << 18; BYTE(0x40020001) = 0x80;
    while (!(BYTE(0x40020000) & 0x80)) { __asm__("wfi"); }
    BYTE(0x40020001) = 0; WORD(0xE000E180) = WORD(0xE000E280) = 1u << 18;
}
"""
# Each command and what came of it: FSTAT, and what stands where its data was.
TABLE = """
static const unsigned table[][3] = { %s };
#define COUNT (sizeof table / sizeof table[0])
volatile unsigned results[COUNT][3];
int main(void) {
    stop_watchdog();
    %s
    for (unsigned i = 0; i < COUNT; i++) {
        command(table[i][0], table[i][1], table[i][2]);
        results[i][0] = BYTE(0x40020000); results[i][1] = WORD(0x40020008); results[i][2] = WORD(0x4002000C);
    }
    return 0;
}
"""
Command = tuple[int, int, int]


def carried_out(
    build_c: Build, commands: list[Command], before: str = "", flash_file: Path | None = None
) -> tuple[VirtualK64F, list[tuple[int, int, int]]]:
    """Run a program that gives these commands; return the board, and what came of each."""
    rows = ", ".join(f"{{0x{one:08x}u, 0x{two:08x}u, 0x{three:08x}u}}" for one, two, three in commands)
    board = VirtualK64F(build_c(HEAD + TABLE % (rows, before)), flash_file=flash_file)
    board.run_until(3.0)
    results = board.processor.memory.read(board.image.symbols["results"].address, 12 * len(commands))
    return board, list(struct.iter_unpack("<3I", results))


def stated(code: int, address: int) -> int:
    return code << 24 | address


def test_a_phrase_is_programmed_read_back_and_erased(build_c: Build) -> None:
    place = 0x90008
    board, results = carried_out(
        build_c,
        [
            (stated(0x09, place & ~0xF), 0, 0),
            (stated(0x07, place), 0x11223344, 0x55667788),
            (stated(0x02, place), 0x01000000, 0x11223344),
            (stated(0x02, place + 4), 0x02000000, 0x55667788),
            (stated(0x02, place), 0x01000000, 0x11223345),
            (stated(0x01, place & ~0xF), 0x00010000, 0),
            (stated(0x01, place + 8), 0x00010000, 0),
        ],
    )
    assert [result[0] for result in results] == [DONE] * 4 + [DONE | FAILED] * 2 + [DONE]
    assert board.processor.memory.read_words(place, 2) == (0x11223344, 0x55667788)
    assert board.unmodelled == ()


def test_programming_clears_bits_and_says_so_where_ones_were_wanted(build_c: Build) -> None:
    board, results = carried_out(
        build_c,
        [
            (stated(0x07, 0x90000), 0x0000FFFF, 0xFFFFFFFF),
            (stated(0x07, 0x90000), 0x12345678, 0xFFFFFFFF),
        ],
    )
    assert [result[0] for result in results] == [DONE, DONE | FAILED]
    assert board.processor.memory.read_words(0x90000, 2) == (0x00005678, 0xFFFFFFFF)


def test_blocks_are_erased_and_verified_one_by_one(build_c: Build) -> None:
    board, results = carried_out(
        build_c,
        [
            (stated(0x07, 0xFFFF8), 0, 0),
            (stated(0x00, 0x80000), 0, 0),
            (stated(0x40, 0), 0, 0),
            (stated(0x08, 0x80010), 0, 0),
            (stated(0x00, 0x80000), 0, 0),
        ],
    )
    # Read 1s of all blocks looks at the first one too, which holds the program that asks for it.
    assert [result[0] for result in results] == [
        DONE,
        DONE | FAILED,
        DONE | FAILED | COLLISION,
        DONE,
        DONE,
    ]
    assert board.processor.memory.read(0xFFFF8, 8) == b"\xff" * 8
    assert board.processor.memory.read(0, 4) != b"\xff" * 4


@pytest.mark.parametrize(
    "command",
    [
        (stated(0x07, 0x90004), 0, 0),
        (stated(0x07, 0x100000), 0, 0),
        (stated(0x09, 0x90008), 0, 0),
        (stated(0x01, 0x90000), 0, 0),
        (stated(0x01, 0xFFFF0), 0x00020000, 0),
        (stated(0x01, 0x90000), 0x00010300, 0),
        (stated(0x02, 0x90000), 0, 0),
        (0x41080000, 0, 0),
        (0x43080000, 0, 0),
        (stated(0x03, 0x400), 0, 0),
        (stated(0x06, 0x90000), 0, 0),
        (stated(0x80, 0), 0, 0),
    ],
    ids=[
        "phrase not aligned",
        "beyond the flash",
        "sector not aligned",
        "section of nothing",
        "section over the end",
        "no such margin",
        "no such margin of program check",
        "no such record",
        "no such record to program",
        "no such resource",
        "longword",
        "partition",
    ],
)
def test_what_cannot_be_done_is_an_access_error(build_c: Build, command: Command) -> None:
    board, results = carried_out(build_c, [command])
    assert results[0][0] == DONE | ACCESS
    assert board.processor.memory.read(0x80000, 0x80000) == b"\xff" * 0x80000


def test_after_an_error_nothing_is_launched_until_it_is_cleared(build_c: Build) -> None:
    source = """
    int main(void) {
        stop_watchdog();
        command(0x07090004u, 0, 0);
        WORD(0x40020004) = 0x07090000u; BYTE(0x40020000) = 0x80; status = BYTE(0x40020000);
        command(0x07090000u, 0x12u, 0);
        first = BYTE(0x40020000);
        return 0;
    }
    """
    board = VirtualK64F(build_c(HEAD + source))
    board.run_until(0.01)
    assert board.processor.memory.read(board.image.symbols["status"].address, 1)[0] == DONE | ACCESS
    assert word(board, "first") == DONE
    assert board.processor.memory.read_words(0x90000, 2) == (0x12, 0)


def test_a_protected_region_is_neither_programmed_nor_erased(build_c: Build) -> None:
    # FPROT's byte at the highest address has the highest regions, of 32 KiB each: 0xF8000 on; it cannot be taken back.
    protect = "BYTE(0x40020013) = 0x7F; BYTE(0x40020013) = 0xFF; first = BYTE(0x40020013);"
    board, results = carried_out(
        build_c,
        [
            (stated(0x07, 0xF8000), 0, 0),
            (stated(0x09, 0xFF000), 0, 0),
            (stated(0x08, 0x80000), 0, 0),
            (stated(0x44, 0), 0, 0),
            (stated(0x07, 0xF7FF8), 0, 0),
        ],
        protect,
    )
    assert [result[0] for result in results] == [DONE | PROTECTION] * 4 + [DONE]
    assert word(board, "first") == 0x7F


def test_a_command_from_the_block_that_it_works_on_collides(build_c: Build) -> None:
    _, results = carried_out(build_c, [(stated(0x09, 0x70000), 0, 0), (stated(0x09, 0x80000), 0, 0)])
    assert [result[0] for result in results] == [DONE | COLLISION, DONE]


def test_records_are_programmed_once(build_c: Build) -> None:
    _, results = carried_out(
        build_c,
        [
            (0x41020000, 0, 0),
            (0x43020000, 0xCAFEF00D, 0x12345678),
            (0x43020000, 0, 0),
            (0x41020000, 0, 0),
            (stated(0x03, 0x3D0), 0, 0),
            (stated(0x03, 0x3C0), 0, 0),
            (stated(0x03, 0x40008), 0, 0),
        ],
    )
    blank, stored = (0xFFFFFFFF, 0xFFFFFFFF), (0xCAFEF00D, 0x12345678)
    assert [result[0] & ~COLLISION for result in results] == [DONE, DONE, DONE | ACCESS] + [DONE] * 4
    assert [results[index][1:] for index in (0, 3, 4, 5, 6)] == [blank, stored, stored, blank, blank]


def test_code_in_ram_erases_all_of_the_flash_and_no_record(build_c: Build) -> None:
    source = """
    __attribute__((section(".data"), noinline)) static void erase(void) {
        BYTE(0x40020000) = 0x70; WORD(0x40020004) = 0x44000000u; BYTE(0x40020000) = 0x80;
        BYTE(0x40020001) = 0x80; WORD(0xE000E100) = 1u << 18;
        while (!(BYTE(0x40020000) & 0x80)) { __asm__("wfi"); }
        first = BYTE(0x40020000);
        BYTE(0x40020001) = 0; WORD(0xE000E280) = 1u << 18;
        for (;;) { __asm__("wfi"); }
    }
    int main(void) {
        stop_watchdog();
        command(0x43000000u, 1, 2);
        static void (*volatile in_ram)(void) = erase;
        in_ram();
        return 0;
    }
    """
    board = VirtualK64F(build_c(HEAD + source))
    follow(board, {1.0: {"first": DONE}})
    assert board.processor.memory.read(0, 1 << 20) == b"\xff" * (1 << 20)
    assert board._chip.flash.once[:8] == struct.pack("<II", 1, 2)


@pytest.mark.parametrize(
    ("command", "second", "name"),
    [(0x46080000, 0, "swap control"), (0x0B090000, 0, "program section"), (0x03000008, 1 << 24, "version ID")],
    ids=["swap", "section", "version"],
)
def test_commands_that_are_left_out_are_reported_by_name(build_c: Build, command: int, second: int, name: str) -> None:
    board, results = carried_out(build_c, [(command, second, 0)])
    assert results[0][0] == DONE | ACCESS
    (answer,) = [str(access) for access in board.unmodelled]
    assert answer.startswith(
        f"FTFE_FCCOB0's {name} at 0x40020007 is not modelled; write of 0x{command >> 24:02x} from 0x"
    )
    assert "in command (program.c:" in answer
    assert answer.endswith(" set ACCERR")


def test_the_part_is_unsecured_and_its_settings_are_those_in_the_flash(build_c: Build) -> None:
    source = "int main(void) { first = WORD(0x40020000); second = WORD(0x40020010); return 0; }"
    elf = bytearray(build_c(HEAD + source).read_bytes())
    configuration = struct.pack("<QII", 2**64 - 1, 2**32 - 1, 0xFFFFFFFE)
    (at,) = [index for index in range(len(elf)) if elf.startswith(configuration, index)]
    elf[at + 8 : at + 16] = bytes.fromhex("F0FFFF7F 73FBFFFF")
    board = VirtualK64F(bytes(elf))
    board.run_until(0.001)
    assert word(board, "first") == 0xFB720680  # FOPT, FSEC: unsecured whatever its SEC says, FCNFG, FSTAT
    assert word(board, "second") == 0x7FFFFFF0


def test_a_command_takes_its_time_and_interrupts_at_its_end(build_c: Build) -> None:
    source = """
    void Interrupt18_Handler(void) { took = WORD(0xE0001004) - first; BYTE(0x40020001) = 0; caught++; }
    int main(void) {
        stop_watchdog();
        WORD(0xE000EDFC) |= 1u << 24; WORD(0xE0001000) = 1; WORD(0xE000E100) = 1u << 18;
        WORD(0x40020004) = 0x09090000u; BYTE(0x40020000) = 0x80; first = WORD(0xE0001004); BYTE(0x40020001) = 0x80;
        while (!caught) { __asm__("wfi"); }
        return 0;
    }"""
    board = VirtualK64F(build_c(HEAD + source))
    follow(board, {0.1: {"caught": 1}})
    # 15 ms at 20.97 MHz; a few cycles to read the counter and to enter the handler.
    assert word(board, "took") == pytest.approx(0.015 * 640 * 32768, abs=40)


REWRITING = """
// A number in r0; one does nothing beside it, the other loads a word.
static const unsigned short returns[2][4] = { {0x2011, 0xBF00, 0x4770, 0}, {0x2022, 0x4900, 0x4770, 0} };
volatile unsigned got[4];
int main(void) {
    stop_watchdog();
    for (unsigned i = 0; i < 4; i++) {
        const unsigned *code = (const unsigned *)returns[i % 2];
        command(0x09090000u, 0, 0);
        command(0x07090020u, code[0], code[1]);
        got[i] = ((unsigned (*)(void))0x90021)();
    }
    return 0;
}
"""


def test_code_that_is_programmed_is_what_runs_and_what_is_counted(build_c: Build) -> None:
    board = ran(build_c(HEAD + REWRITING), 0.1)
    assert board.processor.memory.read_words(board.image.symbols["got"].address, 4) == (0x11, 0x22, 0x11, 0x22)


COUNTING = """
int main(void) {
    unsigned number = 0;
    stop_watchdog();
    while (WORD(0x90000 + 8 * number) != ~0u) { number++; }
    command(0x07090000u + 8 * number, number, 0);
    first = number + 1;
    if (number < %d) { WORD(0xE000ED0C) = 0x05FA0004; }
    for (;;) { __asm__("wfi"); }
}
"""


def test_flash_keeps_what_was_programmed_across_resets(build_c: Build) -> None:
    board = VirtualK64F(build_c(HEAD + COUNTING % 3))
    follow(board, {0.01: {"first": 4}})
    board.boot()  # power-on of a board that has been loaded anew
    follow(board, {0.0201: {"first": 4}})


def test_a_file_keeps_the_flash_from_run_to_run_but_for_what_the_image_loads(build_c: Build, tmp_path: Path) -> None:
    stored = tmp_path / "flash.bin"
    elf = build_c(HEAD + COUNTING % 0)
    for boots in (1, 2, 3):
        board = VirtualK64F(elf, flash_file=str(stored))
        board.run_until(0.01)
        assert word(board, "first") == boots
    content = bytearray(stored.read_bytes())
    assert struct.unpack_from("<QQQ", content, 0x90000) == (0, 1, 2)
    assert content[:8] == board.processor.memory.read(0, 8)
    content[:8] = bytes(8)  # in the image's own sector: another image, or damage
    stored.write_bytes(content)
    board = VirtualK64F(elf, flash_file=stored)
    follow(board, {0.01: {"first": 4}})


def test_a_file_keeps_the_records_too(build_c: Build, tmp_path: Path) -> None:
    stored = tmp_path / "flash.bin"
    carried_out(build_c, [(0x43020000, 0xCAFEF00D, 0x12345678)], flash_file=stored)
    _, results = carried_out(build_c, [(0x41020000, 0, 0)], flash_file=stored)
    assert results[0][1:] == (0xCAFEF00D, 0x12345678)


def test_a_file_that_is_no_flash_is_refused(build_c: Build, tmp_path: Path) -> None:
    elf = build_c(HEAD + COUNTING % 0)
    stored = tmp_path / "flash.bin"
    stored.write_bytes(b"something else")
    nowhere = tmp_path / "nowhere" / "flash.bin"
    for wrong, reason in ((stored, "14 bytes"), (nowhere, "No such file"), (tmp_path, "a folder")):
        with pytest.raises(ConfigError, match=reason):
            VirtualK64F(elf, flash_file=wrong).run_until(0.01)
    assert stored.read_bytes() == b"something else"
