"""DSPI: frames to the parts whose chip select is low, their time, FIFOs, interrupts and DMA."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.state import Restorable
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.world import EarthField, World
from hiltest.world.recorded_motion import Sensed
from hiltest.world.sensors import SensorSetup
from hiltest.world.sensors.lis3mdl import Lis3mdl

from .conftest import Build, follow, word

HEAD = """
#define SPI(offset) WORD(0x4002C000 + (offset))
#define GPIOD(offset) WORD(0x400FF0C0 + (offset))
#define PCR(pin) WORD(0x4004C000 + 4 * (pin))
enum { MCR, TCR = 8, CTAR0 = 12, CTAR1 = 16, SR = 0x2C, RSER = 0x30, PUSHR = 0x34, POPR = 0x38, RXFR0 = 0x7C };
enum { PSOR = 4, PCOR = 8, PDDR = 20 };
#define MASTER 0x80000000u
#define CONT 0x80000000u
#define BYTES 0x38000000u /* eight bits, prescaler 2, scaler 2: a quarter of the bus clock */
volatile unsigned fired, began, took, status, count, words[16];
void Interrupt26_Handler(void) { fired++; status = SPI(SR); SPI(SR) = 0x80000000u; }
static void begin(void) {
    stop_watchdog();
    WORD(0x40048038) |= 1u << 12; WORD(0x4004803C) |= 1u << 12;
    WORD(0xE000EDFC) = 1u << 24; WORD(0xE0001000) = 1; /* CYCCNT */
    SPI(CTAR0) = BYTES;
}
static void chip_select_by_gpio(void) { GPIOD(PSOR) = 1; GPIOD(PDDR) = 1; PCR(0) = 0x100; SPI(MCR) = MASTER; }
static void chip_select_by_module(void) { PCR(0) = 0x200; SPI(MCR) = MASTER | 1u << 16; }
static unsigned exchange(unsigned word) {
    SPI(PUSHR) = word;
    while (!(SPI(SR) & 1u << 17)) {}
    SPI(SR) = 1u << 31 | 1u << 17;
    return SPI(POPR);
}
"""


class Recorder(Restorable):
    """A part that writes down each byte with its time, and answers with the complement."""

    def __init__(self) -> None:
        self.seen: list[tuple[str, int]] = []
        self.times_s: list[float] = []

    def select(self, time_s: float) -> None:
        self.seen.append(("select", 0))

    def exchange(self, value: int, time_s: float) -> int:
        self.seen.append(("byte", value))
        self.times_s.append(time_s)
        return ~value & 0xFF

    def stop(self, time_s: float) -> None:
        self.seen.append(("stop", 0))

    @property
    def transfers(self) -> list[list[int]]:
        """The bytes between a fall and a rise of the chip select that had any."""
        transfers: list[list[int]] = []
        for kind, value in self.seen:
            if kind == "select":
                transfers.append([])
            elif kind == "byte":
                transfers[-1].append(value)
        return [transfer for transfer in transfers if transfer]


def run(build_c: Build, body: str, part: object, *, until_s: float = 0.01, head: str = "") -> VirtualK64F:
    program = f"{HEAD}{head}int main(void) {{ begin(); {body} count++; return 0; }}"
    board = VirtualK64F(build_c(program, "-Wno-unused-function"), spi0={"PTD0": part}, strict=True)
    follow(board, {until_s: {"count": 1}})
    return board


def words(board: VirtualK64F, n: int) -> list[int]:
    return list(board.processor.memory.read_words(board.image.symbols["words"].address, n))


def test_a_chip_select_by_gpio_frames_the_bytes(build_c: Build) -> None:
    body = "words[{}] = exchange({}); words[{}] = exchange({});"
    select, deselect = "GPIOD(PCOR) = 1;", "GPIOD(PSOR) = 1;"
    part = Recorder()
    board = run(
        build_c,
        f"chip_select_by_gpio(); words[4] = exchange(0x11); {select} {body.format(0, 0xA5, 1, 0x3C)} {deselect}"
        f"{select} {body.format(2, 1, 3, 2)} {deselect}",
        part,
    )
    assert part.transfers == [[0xA5, 0x3C], [1, 2]]
    assert part.seen[-1] == ("stop", 0)
    assert words(board, 5) == [0x5A, 0xC3, 0xFE, 0xFD, 0xFF]  # nobody drives the line without a chip select


def test_a_chip_select_of_the_module_lasts_while_its_frames_continue(build_c: Build) -> None:
    first = f"exchange(CONT | {1 << 16}u | 0x10); exchange(CONT | {1 << 16}u | 0x20); exchange({1 << 16}u | 0x30);"
    part = Recorder()
    run(build_c, f"chip_select_by_module(); {first} exchange({1 << 16}u | 0x40); exchange({1 << 17}u | 0x50);", part)
    assert part.transfers == [[0x10, 0x20, 0x30], [0x40]]


@pytest.mark.parametrize(
    ("attributes", "bus_clocks"),
    [
        (0x38000000, 8 * 4 + 2 + 2 + 2),  # and the three shortest delays around a transfer
        (0x38000003, 8 * 2 * 8 + 6),
        (0xB8010001, 8 * 3 * 4 // 2 + 6),
        (0x78000000, 16 * 4 + 6),
        (0x38003120, 8 * 4 + 16 + 4 + 8),
    ],
)
def test_a_frame_lasts_as_its_attributes_say(build_c: Build, attributes: int, bus_clocks: int) -> None:
    part = Recorder()
    again = (
        f"SPI(CTAR0) = {attributes}u; began = WORD(0xE0001004); for (unsigned i = 0; i < 4; i++) SPI(PUSHR) = 1u << 16;"
    )
    body = f"chip_select_by_module(); {again} while ((SPI(SR) >> 4 & 15) < 4) {{}} took = WORD(0xE0001004) - began;"
    board = run(build_c, body, part)
    size = 2 if attributes >> 27 & 15 == 15 else 1
    steps = np.diff(part.times_s[::size])
    assert steps * 640 * 32_768 == pytest.approx(
        [bus_clocks] * 3, abs=1e-3
    )  # the bus has the core's clock out of reset
    assert word(board, "took") == pytest.approx(4 * bus_clocks, abs=40)  # a turn of the loop, and the writes before it


def test_the_fifos_hold_four_words_and_lose_further_ones(build_c: Build) -> None:
    fill = "for (unsigned i = 1; i < 8; i++) SPI(PUSHR) = 1u << 16 | i;"
    drain = "for (unsigned i = 0; i < 5; i++) words[i] = SPI(POPR);"
    part = Recorder()
    board = run(
        build_c,
        f"chip_select_by_module(); SPI(MCR) |= 1; {fill} status = SPI(SR); SPI(MCR) &= ~1u;"
        f"while (SPI(SR) >> 12 & 15) {{}} SPI(PUSHR) = 1u << 16 | 0x77; SPI(SR) = 1u << 31;"
        f"while (!(SPI(SR) & 1u << 19)) {{}} words[7] = SPI(TCR) >> 16; words[8] = SPI(RXFR0 + 4); {drain}",
        part,
    )
    assert word(board, "status") == 4 << 12, "stopped, and no room"
    assert part.transfers == [[1], [2], [3], [4], [0x77]]
    assert words(board, 5) == [0xFE, 0xFD, 0xFC, 0xFB, 0]
    assert words(board, 9)[7:] == [5, 0xFD]


def test_the_end_of_a_queue_stops_the_module_until_its_flag_is_cleared(build_c: Build) -> None:
    part = Recorder()
    queue = "SPI(PUSHR) = 1u << 27 | 1u << 16 | 1; SPI(PUSHR) = 1u << 16 | 2;"
    board = run(
        build_c,
        f"chip_select_by_module(); {queue} while (!(SPI(SR) & 1u << 28)) {{}}"
        "for (volatile int i = 0; i < 99; i++) {}"
        "status = SPI(SR); SPI(SR) = 1u << 28; while ((SPI(SR) >> 4 & 15) < 2) {} words[0] = SPI(SR);",
        part,
    )
    assert word(board, "status") & (1 << 30 | 15 << 12) == 1 << 12, "the second word waits"
    assert words(board, 1)[0] & 1 << 30
    assert part.transfers == [[1], [2]]


def test_the_end_of_a_frame_interrupts(build_c: Build) -> None:
    body = "chip_select_by_module(); WORD(0xE000E100) = 1u << 26; SPI(RSER) = 1u << 31; SPI(PUSHR) = 1u << 16 | 9;"
    board = run(build_c, f"{body} while (!fired) {{}} for (volatile int i = 0; i < 99; i++) {{}}", Recorder())
    assert word(board, "fired") == 1
    assert word(board, "status") >> 31 == 1


def test_frames_of_sixteen_bits_are_two_bytes_and_lsbfe_mirrors_them(build_c: Build) -> None:
    part = Recorder()
    sixteen = f"SPI(CTAR0) = 0x78000000u; words[0] = exchange({1 << 16}u | 0xA1B2);"
    mirrored = f"SPI(CTAR1) = 0x39000000u; words[1] = exchange({1 << 28 | 1 << 16}u | 0x01);"
    board = run(build_c, f"chip_select_by_module(); {sixteen} {mirrored}", part)
    assert part.transfers == [[0xA1, 0xB2], [0x80]]
    assert words(board, 2) == [0x5E4D, 0xFE]


def test_dma_moves_bytes_both_ways(build_c: Build) -> None:
    dma = """
    #define TCD(channel, offset) WORD(0x40009000 + 32 * (channel) + (offset))
    static unsigned commands[6] = { 1u << 31 | 1u << 16 | 1, 1u << 31 | 1u << 16 | 2, 1u << 31 | 1u << 16 | 3,
                                    1u << 31 | 1u << 16 | 4, 1u << 31 | 1u << 16 | 5, 1u << 16 | 6 };
    static void channel(int number, unsigned from, int step, unsigned to, int next) {
        TCD(number, 0) = from; TCD(number, 4) = 0x0202u << 16 | step; TCD(number, 8) = 4; TCD(number, 12) = 0;
        TCD(number, 16) = to; TCD(number, 20) = 6u << 16 | next; TCD(number, 24) = 0; TCD(number, 28) = 6u << 16 | 8;
    }
    """
    start = """
    WORD(0x40048040) |= 1u << 1; WORD(0x4004803C) |= 1u << 1;
    channel(0, 0x4002C038, 0, (unsigned)words, 4); channel(1, (unsigned)commands, 4, 0x4002C034, 0);
    *(volatile unsigned char *)0x40021000 = 0x80 | 14; *(volatile unsigned char *)0x40021001 = 0x80 | 15;
    chip_select_by_module(); WORD(0x4000800C) = 3; SPI(RSER) = 1u << 25 | 1u << 24 | 1u << 17 | 1u << 16;
    while (WORD(0x4000800C) & 3) {}
    """
    part = Recorder()
    board = run(build_c, start, part, head=dma)
    assert part.transfers == [[1, 2, 3, 4, 5, 6]]
    assert words(board, 6) == [0xFE, 0xFD, 0xFC, 0xFB, 0xFA, 0xF9]


def test_firmware_reads_a_lis3mdl(build_c: Build) -> None:
    part = Lis3mdl(SensorSetup(World(EarthField(48.5, 62.0)), noise={Sensed.MAGNETOMETER: 0.0}))
    select, deselect = "GPIOD(PCOR) = 1;", "GPIOD(PSOR) = 1;"
    identity = f"{select} exchange(0x8F); words[0] = exchange(0); words[1] = exchange(0); {deselect}"
    start = f"{select} exchange(0x22); exchange(0); {deselect} for (volatile int i = 0; i < 900000; i++) {{}}"
    read = f"{select} exchange(0xE8); for (int i = 2; i < 8; i++) words[i] = exchange(0); {deselect}"
    board = run(build_c, f"chip_select_by_gpio(); {identity} {start} {read}", part, until_s=0.9)
    assert words(board, 2) == [0x3D, 0x3D], "without bit 6 the address stays"
    field_ut = np.frombuffer(bytes(words(board, 8)[2:]), "<i2") / 68.42
    assert field_ut == pytest.approx(part.setup.world.state_at(0.0).field_body_ut, abs=0.01)  # a count is 0.015 uT


def test_a_frame_ends_again_after_a_restored_snapshot(build_c: Build) -> None:
    slow = "chip_select_by_module(); SPI(CTAR0) = BYTES | 6; SPI(PUSHR) = 1u << 16 | 5; for (;;) {}"  # 49 us
    part = Recorder()
    board = VirtualK64F(
        build_c(f"{HEAD}int main(void) {{ begin(); {slow} }}", "-Wno-unused-function"), spi0={"PTD0": part}
    )
    board.run_until(30e-6)
    snapshot, begun = board.snapshot(), list(part.seen)
    assert begun[-1] == ("select", 0)
    for _ in range(2):
        board.restore(snapshot)
        assert part.seen == begun
        board.run_until(100e-6)
        assert part.seen == [*begun, ("byte", 5), ("stop", 0)]
