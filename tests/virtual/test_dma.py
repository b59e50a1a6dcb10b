"""The eDMA and its multiplexer: what channels move, when, for whom, and what they refuse."""

from __future__ import annotations

import itertools
import struct
from dataclasses import dataclass, replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.core.library import lib

from .conftest import Build, follow, word
from .oracle import ran
from .test_peripherals import Part

DMA, DESCRIPTORS, MULTIPLEXER = 0x40008000, 0x40009000, 0x40021000
CR, ES, ERQ, EEI, INT, ERR, HRS = 0x0, 0x4, 0xC, 0x14, 0x24, 0x2C, 0x34
CDNE, SSRT = 0x1C, 0x1D
START, INTMAJOR, INTHALF, DREQ, ESG, MAJORELINK, ACTIVE, DONE = (1 << bit for bit in range(8))
RAM = 0x20004000

HEAD = """
#define PTR(pointer) ((unsigned)(pointer))
struct descriptor {
    unsigned saddr; short soff; unsigned short attr; unsigned nbytes; int slast; unsigned daddr; short doff;
    unsigned short citer; int dlast; unsigned short csr, biter;
};
#define TCD(channel) ((volatile struct descriptor *)(0x40009000 + 32 * (channel)))
static void begin(void) {
    stop_watchdog();
    WORD(0x40048040) |= 1u << 1;
    WORD(0x4004803C) |= 1u << 1;
}
static void set(int channel, struct descriptor descriptor) {
    TCD(channel)->csr = 0; *TCD(channel) = descriptor;
}
#define SLEEP for (;;) { __asm__("wfi"); }
"""


@dataclass(frozen=True)
class Loop:
    """A descriptor, as the manual names its registers; sizes in bytes."""

    saddr: int = RAM
    soff: int = 4
    source_size: int = 4
    smod: int = 0
    nbytes: int = 16
    slast: int = 0
    daddr: int = RAM + 0x1000
    doff: int = 4
    destination_size: int = 4
    dmod: int = 0
    count: int = 1
    dlast: int = 0
    csr: int = 0
    citer: int | None = None

    def registers(self) -> bytes:
        code = {1: 0, 2: 1, 4: 2, 16: 4, 32: 5}
        attr = self.smod << 11 | code[self.source_size] << 8 | self.dmod << 3 | code[self.destination_size]
        citer = self.count if self.citer is None else self.citer
        return struct.pack(
            "<IhHIiIhHiHH",
            self.saddr,
            self.soff,
            attr,
            self.nbytes,
            self.slast,
            self.daddr,
            self.doff,
            citer,
            self.dlast,
            self.csr,
            self.count,
        )


class Bench:
    """A board whose processor sleeps, and the registers of its eDMA."""

    def __init__(self, build_c: Build) -> None:
        self.board = VirtualK64F(build_c(f"{HEAD} int main(void) {{ begin(); SLEEP }}"))
        self.board.run_until(0.001)
        self.memory = self.board.processor.memory

    def write(self, offset: int, value: int, size: int = 4) -> None:
        self.board._chip.bus.write(DMA + offset, size, value)

    def read(self, offset: int, size: int = 4) -> int:
        return self.board._chip.bus.read(DMA + offset, size)

    def load(self, channel: int, loop: Loop) -> None:
        words = struct.unpack("<8I", loop.registers())
        for index, value in enumerate(words):
            self.board._chip.bus.write(DESCRIPTORS + 32 * channel + 4 * index, 4, value)

    def control(self, channel: int) -> int:
        return self.board._chip.bus.read(DESCRIPTORS + 32 * channel + 0x1C, 2)

    def addresses(self, channel: int) -> tuple[int, int, int]:
        """SADDR, DADDR and CITER."""
        read = self.board._chip.bus.read
        return tuple(read(DESCRIPTORS + 32 * channel + at, size) for at, size in ((0, 4), (0x10, 4), (0x16, 2)))  # type: ignore[return-value]

    def run(self, seconds: float = 0.0002) -> None:
        self.board.run_until(self.board.time_s + seconds)

    def clear(self) -> None:
        for offset, value in ((CR, 0), (ERQ, 0), (EEI, 0), (INT, 0xFFFF), (ERR, 0xFFFF)):
            self.write(offset, value)


@pytest.fixture
def bench(build_c: Build) -> Bench:
    return Bench(build_c)


def moved(before: bytearray, loop: Loop, minor_offset: tuple[bool, bool, int] = (False, False, 0)) -> tuple[int, int]:
    """Move what all minor loops of a descriptor move, byte by byte as the manual says; return the last addresses."""

    def stepped(address: int, offset: int, modulo: int) -> int:
        size = 1 << modulo if modulo else 1 << 32
        return address // size * size + (address + offset) % size

    source, destination = loop.saddr, loop.daddr
    for minor in range(loop.count):
        queue: list[int] = []
        for _ in range(loop.nbytes // max(loop.source_size, loop.destination_size)):
            while len(queue) < loop.destination_size:
                queue += before[source - RAM : source - RAM + loop.source_size]
                source = stepped(source, loop.soff, loop.smod)
            while len(queue) >= loop.destination_size:
                selected, queue = queue[: loop.destination_size], queue[loop.destination_size :]
                before[destination - RAM : destination - RAM + loop.destination_size] = bytes(selected)
                destination = stepped(destination, loop.doff, loop.dmod)
        if minor < loop.count - 1:
            source += minor_offset[2] if minor_offset[0] else 0
            destination += minor_offset[2] if minor_offset[1] else 0
    return source + loop.slast, destination + loop.dlast


SIZES = st.sampled_from([1, 2, 4, 16, 32])


@st.composite
def loops(draw: st.DrawFn) -> tuple[Loop, tuple[bool, bool, int]]:
    """Draw a descriptor that stays inside 32 KiB of RAM, and its offset of minor loops."""
    source, destination = draw(SIZES), draw(SIZES)
    largest = max(source, destination)
    loop = Loop(
        saddr=RAM + 0x4000 + draw(st.integers(-8, 8)) * source,
        soff=draw(st.integers(-3, 3)) * source,
        source_size=source,
        smod=draw(st.sampled_from([0, 0, 6, 7])),
        nbytes=largest * draw(st.integers(1, 6)),
        slast=draw(st.integers(-64, 64)),
        daddr=RAM + 0x4000 + draw(st.integers(-40, 40)) * destination,
        doff=draw(st.integers(-3, 3)) * destination,
        destination_size=destination,
        dmod=draw(st.sampled_from([0, 0, 6, 7])),
        count=draw(st.integers(1, 6)),
        dlast=draw(st.integers(-64, 64)),
    )
    return loop, (draw(st.booleans()), draw(st.booleans()), largest * draw(st.integers(-4, 4)))


def test_what_is_moved_is_what_the_descriptor_says(bench: Bench) -> None:
    content = bytes(range(256)) * 128

    @settings(suppress_health_check=[HealthCheck.too_slow])
    @given(loops(), st.booleans())
    def run(drawn: tuple[Loop, tuple[bool, bool, int]], offsets: bool) -> None:
        loop, minor = drawn
        bench.clear()
        bench.memory.write(RAM, content)
        expected = bytearray(content)
        bench.write(CR, 0x80 if offsets else 0)
        coded = minor[0] << 31 | minor[1] << 30 | (minor[2] & 0xFFFFF) << 10 if offsets and any(minor[:2]) else 0
        bench.load(0, replace(loop, nbytes=loop.nbytes | coded))
        addresses = moved(expected, loop, minor if coded else (False, False, 0))
        for index in range(loop.count, 0, -1):
            assert bench.addresses(0)[2] == index
            assert not bench.control(0) & DONE
            bench.write(SSRT, 0, 1)
            bench.run()
        assert bench.control(0) == DONE
        assert bench.addresses(0) == (*addresses, loop.count)
        assert bench.memory.read(RAM, len(content)) == expected

    run()


def test_a_minor_loop_takes_the_time_that_the_manual_counts(bench: Bench) -> None:
    processor = bench.board.processor
    gpio = 0x400FF000
    for loop, cycles in (
        (Loop(nbytes=16), 4 + 4 * (1 + 1) + 3),
        (Loop(nbytes=4, source_size=1, soff=1), 4 + 4 + 1 + 3),
        (Loop(nbytes=32, source_size=32, soff=32), 4 + 8 + 8 + 3),
        (Loop(nbytes=4, daddr=gpio), 4 + 1 + 4 + 3),
        (Loop(nbytes=8, saddr=gpio, soff=0), 4 + 2 * 3 + 2 + 3),
    ):
        bench.load(0, loop)
        bench.write(SSRT, 0, 1)
        assert bench.control(0) == ACTIVE
        assert lib.machine_next_event(processor.machine.handle) == processor.cycles + cycles
        bench.run()


def test_interrupts_come_at_half_and_at_the_end(bench: Bench) -> None:
    for flags, expected in ((0, [0, 0, 0, 0]), (INTHALF, [0, 1, 0, 0]), (INTMAJOR, [0, 0, 0, 1])):
        bench.clear()
        bench.load(3, Loop(count=4, csr=flags))
        observations = []
        for _ in range(4):
            bench.write(SSRT, 3, 1)
            bench.run()
            assert bench.board.processor.nvic.is_driven(3) == bool(bench.read(INT))
            observations.append(bench.read(INT) >> 3)
            bench.write(INT, 8)
        assert observations == expected


def test_a_channel_starts_another_after_each_minor_loop_and_after_the_last(bench: Bench) -> None:
    bench.memory.write(RAM, bytes(range(64)))
    linked = 1 << 15 | 5 << 9 | 3
    bench.load(2, Loop(nbytes=4, count=linked, csr=MAJORELINK | 6 << 8))
    bench.load(5, Loop(saddr=RAM + 32, daddr=RAM + 0x2000, nbytes=4, count=8))
    bench.load(6, Loop(saddr=RAM + 48, daddr=RAM + 0x3000, nbytes=4, count=8))
    progress = []
    for _ in range(3):
        bench.write(SSRT, 2, 1)
        bench.run()
        progress.append((bench.addresses(5)[2], bench.addresses(6)[2]))
    assert progress == [(7, 8), (6, 8), (6, 7)]  # the last minor loop has the link of the major loop instead
    assert bench.memory.read(RAM + 0x3000, 4) == bytes(range(48, 52))


def test_a_descriptor_brings_the_next_one_from_memory(bench: Bench) -> None:
    bench.memory.write(RAM, bytes(range(64)))
    second, third = RAM + 0x800, RAM + 0x820
    bench.memory.write(third, Loop(saddr=RAM + 32, daddr=RAM + 0x3000, csr=INTMAJOR).registers())
    bench.memory.write(second, Loop(saddr=RAM + 16, daddr=RAM + 0x2000, dlast=third, csr=ESG | START).registers())
    bench.load(1, Loop(dlast=second, csr=ESG | DREQ))
    bench.write(ERQ, 2)
    bench.write(SSRT, 1, 1)
    bench.run()
    assert bench.read(ERQ) == 0
    assert [bench.memory.read(RAM + at, 16) for at in (0x1000, 0x2000)] == [bytes(range(16)), bytes(range(16, 32))]
    assert bench.control(1) == INTMAJOR  # the third waits for its own start
    bench.write(SSRT, 1, 1)
    bench.run()
    assert bench.memory.read(RAM + 0x3000, 16) == bytes(range(32, 48))
    assert (bench.control(1), bench.read(INT)) == (INTMAJOR | DONE, 2)


def test_a_start_while_the_channel_runs_is_another_one(bench: Bench) -> None:
    bench.load(0, Loop(count=3))
    bench.write(SSRT, 0, 1)
    bench.write(SSRT, 0, 1)
    assert bench.control(0) == ACTIVE | START
    bench.run()
    assert bench.addresses(0)[2] == 1


def test_links_are_not_set_up_before_done_is_cleared_and_stay_when_they_were(bench: Bench) -> None:
    write = bench.board._chip.bus.write
    at = DESCRIPTORS + 0x1C
    bench.load(0, Loop(csr=MAJORELINK | 6 << 8))
    bench.write(SSRT, 0, 1)
    bench.run()
    write(at + 2, 2, 1)  # BITER
    assert bench.control(0) == DONE | MAJORELINK | 6 << 8
    write(at, 2, DONE | MAJORELINK | ESG)
    assert bench.control(0) == DONE
    write(at, 2, ACTIVE | MAJORELINK)  # ACTIVE is the controller's
    assert bench.control(0) == MAJORELINK
    write(at, 2, DONE)
    assert bench.control(0) == 0
    bench.write(SSRT, 0, 1)
    bench.run()
    assert bench.control(0) == DONE
    bench.write(CDNE, 0, 1)
    assert bench.control(0) == 0


# Bits of ES, from the manual's table.
DBE, SBE, SGE, NCE, DOE, DAE, SOE, SAE, CPE = (1 << bit for bit in (0, 1, 2, 3, 4, 5, 6, 7, 14))


@pytest.mark.parametrize(
    ("loop", "error"),
    [
        (Loop(saddr=RAM + 2), SAE),
        (Loop(soff=2), SOE),
        (Loop(daddr=RAM + 0x1002), DAE),
        (Loop(doff=1), DOE),
        (Loop(nbytes=6), NCE),
        (Loop(count=0), NCE),
        (Loop(count=1, citer=0x8001), NCE),
        (Loop(csr=ESG, dlast=RAM + 16), SGE),
        (Loop(saddr=0x30000000), SBE),
        (Loop(daddr=0x30000000), DBE),
        (Loop(daddr=0x1000), DBE),
        (Loop(saddr=0x4003D000), SBE),
        (Loop(daddr=0x4003D000), DBE),
        (Loop(saddr=RAM + 2, doff=1), SAE | DOE),
        (Loop(csr=ESG, dlast=0x30000000), SBE),
    ],
    ids=[
        "source",
        "source offset",
        "destination",
        "destination offset",
        "bytes",
        "no count",
        "count linked, not both",
        "scatter address",
        "source nowhere",
        "destination nowhere",
        "destination in flash",
        "source has no clock",
        "destination has no clock",
        "two at once",
        "next descriptor nowhere",
    ],
)
def test_what_cannot_be_moved_is_an_error_of_its_name(bench: Bench, loop: Loop, error: int) -> None:
    bench.write(EEI, 1 << 7)
    bench.load(7, loop)
    bench.write(SSRT, 7, 1)
    bench.run()
    assert bench.read(ES) == 1 << 31 | 7 << 8 | error
    assert bench.read(ERR) == 1 << 7
    assert bench.board.processor.nvic.is_driven(16)
    assert not bench.control(7) & (START | ACTIVE)
    bench.write(ERR, 1 << 7)
    assert not bench.board.processor.nvic.is_driven(16)
    assert bench.read(ES) >> 31 == 0


def test_a_bus_error_leaves_the_addresses_where_it_was(bench: Bench) -> None:
    end = 0x20030000
    bench.load(0, Loop(daddr=end - 8, nbytes=32))
    bench.write(SSRT, 0, 1)
    bench.run()
    assert bench.addresses(0) == (RAM + 12, end, 1)
    assert bench.read(ES) & 0xFF == DBE


def test_an_error_halts_where_that_is_wanted_and_two_equal_priorities_are_one(bench: Bench) -> None:
    bench.write(CR, 1 << 4)
    bench.load(0, Loop())
    bench.write(0x100, 1, 1)  # DCHPRI3
    bench.write(SSRT, 0, 1)
    bench.run()
    assert bench.read(ES) & 0xFFFF == CPE
    assert bench.read(CR) == 1 << 5 | 1 << 4
    bench.write(0x100, 3, 1)
    bench.write(SSRT, 0, 1)
    bench.run()
    assert bench.control(0) == START
    bench.write(CR, 0)
    bench.run()
    assert bench.control(0) == DONE


@pytest.mark.parametrize(
    ("control", "priorities", "order"),
    [
        (0, {}, "ddcba"),
        (0, {0: 3, 3: 0}, "acbd"),
        (1 << 2, {}, "dcbad"),
        (1 << 2, {0: 3, 3: 0}, "dcbad"),
    ],
    ids=["fixed", "fixed, exchanged", "round robin", "round robin heeds no priority"],
)
def test_the_channel_that_is_next_is_chosen_by_priority_or_in_turn(
    bench: Bench, control: int, priorities: dict[int, int], order: str
) -> None:
    uart = bench.board.uarts[1]
    bench.board._chip.bus.write(0x40048034, 4, 1 << 11 | 0xF0100030)
    bench.board._chip.bus.write(0x4006B010, 1, 0x88)  # FIFOs
    bench.board._chip.bus.write(0x4006B003, 1, 0x08)
    uart.line_baud = round(uart.baud)
    bench.memory.write(RAM, b"abcd")
    bench.write(CR, control | 1 << 5)  # halted, until all want
    for channel in range(4):
        bench.write(0x100 + (channel ^ 3), priorities.get(channel, channel), 1)
        bench.load(
            channel,
            Loop(
                saddr=RAM + channel,
                soff=0,
                source_size=1,
                daddr=0x4006B007,
                doff=0,
                destination_size=1,
                nbytes=1,
                count=2,
            ),
        )
        bench.write(SSRT, channel, 1)
    bench.run()
    assert uart.host_waiting == 0
    bench.write(CR, control)
    bench.write(SSRT, 3, 1)  # once more, unless it still waits
    bench.run(0.001)
    assert uart.host_read(10).decode() == order


def test_a_long_loop_takes_its_time_and_keeps_the_host_free(bench: Bench) -> None:
    bench.load(0, Loop(soff=0, doff=0, nbytes=1 << 29))
    bench.write(SSRT, 0, 1)
    before = bench.board.cycles
    bench.run(0.001)
    assert bench.board.cycles - before == pytest.approx(0.001 * 640 * 32768, abs=1)
    assert bench.control(0) == ACTIVE


# -- as firmware uses it ----------------------------------------------------------------------

SENDING = (
    HEAD
    + """
static const char text[] = "the quick brown fox jumps over the lazy dog";
char heard[8];
volatile unsigned sent, received;
void Interrupt0_Handler(void) { BYTE(0x4000801F) = 0; sent++; }
void Interrupt9_Handler(void) { BYTE(0x4000801F) = 9; received++; }
int main(void) {
    begin();
    %(gate)s
    BYTE(%(uart)s) = 0; BYTE(%(uart)s + 1) = 11; BYTE(%(uart)s + 10) = 12; // 115 200 at 20.97 MHz
    BYTE(0x40021000) = 0x80 | %(send)s; BYTE(0x40021009) = 0x80 | %(receive)s;
    set(0, (struct descriptor){.saddr = PTR(text), .soff = 1, .nbytes = 1, .daddr = %(uart)s + 7,
        .citer = sizeof text - 1, .biter = sizeof text - 1, .csr = 0xA});
    set(9, (struct descriptor){.saddr = %(uart)s + 7, .nbytes = 1, .daddr = PTR(heard), .doff = 1, .citer = 8,
        .biter = 8, .dlast = -8, .csr = 0xA});
    WORD(0xE000E100) = 1u << 0 | 1u << 9;
    BYTE(%(uart)s + 11) = 0xA0; BYTE(%(uart)s + 3) = %(c2)s;
    BYTE(0x4000801B) = %(first)s;
    SLEEP
}
"""
)
UARTS = [
    (1, "WORD(0x40048034) |= 1u << 11;", 0x4006B000, 4, 5),
    (2, "WORD(0x40048034) |= 1u << 12;", 0x4006C000, 6, 7),
    (4, "WORD(0x40048028) |= 1u << 10;", 0x400EA000, 10, 10),
]


@pytest.mark.parametrize(("number", "gate", "uart", "receive", "send"), UARTS, ids=["UART1", "UART2", "UART4"])
def test_a_uart_is_served_in_both_directions(
    build_c: Build, number: int, gate: str, uart: int, receive: int, send: int
) -> None:
    for first, c2 in ((0, 0x88), (9, 0x24)):
        filled = {"gate": gate, "uart": uart, "receive": receive, "send": send, "first": first, "c2": c2}
        board = VirtualK64F(build_c(SENDING % filled))
        board.run_until(0.0001)
        board.uarts[number].host_write(b"12345678ab")
        board.run_until(0.02)
        if first == 0:
            assert board.uarts[number].host_read(100) == b"the quick brown fox jumps over the lazy dog"
            assert (word(board, "sent"), word(board, "received")) == (1, 0)
        else:
            assert board.processor.memory.read(board.image.symbols["heard"].address, 8) == b"12345678"
            assert (word(board, "sent"), word(board, "received")) == (0, 1)
        assert board.unmodelled == ()


I2C = (
    HEAD
    + """
#define I2C0 0x40066000
static const unsigned char out[] = {0x2A, 0x01, 0x02, 0x03};
unsigned char in[5];
volatile unsigned done;
static void wait(void) { while (!(BYTE(I2C0 + 3) & 2)) {} BYTE(I2C0 + 3) = 2; }
int main(void) {
    begin();
    WORD(0x40048034) |= 1u << 6;
    BYTE(0x40021000) = 0x80 | 18;
    BYTE(I2C0 + 2) = 0x80; BYTE(I2C0 + 2) = 0xB0; BYTE(I2C0 + 4) = 0x3C; wait();
    set(0, (struct descriptor){.saddr = PTR(out + 1), .soff = 1, .nbytes = 1, .daddr = I2C0 + 4, .citer = 3,
        .biter = 3, .csr = 8});
    BYTE(I2C0 + 2) = 0xB1; BYTE(0x4000801B) = 0; BYTE(I2C0 + 4) = out[0];
    while (!(TCD(0)->csr & 0x80)) {}
    while (!(BYTE(I2C0 + 3) & 0x80)) {}
    BYTE(I2C0 + 3) = 2; BYTE(I2C0 + 2) = 0xB4; BYTE(I2C0 + 4) = 0x3D; wait();
    set(0, (struct descriptor){.saddr = I2C0 + 4, .nbytes = 1, .daddr = PTR(in), .doff = 1, .citer = 5, .biter = 5,
        .csr = 8});
    BYTE(I2C0 + 2) = 0xA1; BYTE(0x4000801B) = 0; (void)BYTE(I2C0 + 4);
    while (!(TCD(0)->csr & 0x80)) {}
    BYTE(I2C0 + 2) = 0x80;
    done = 1;
    SLEEP
}
"""
)


def test_an_i2c_master_is_served_in_both_directions(build_c: Build) -> None:
    part = Part(0x1E)
    board = VirtualK64F(build_c(I2C), i2c0=[part])
    follow(board, {0.01: {"done": 1}})
    assert [value for case, value, _ in part.seen if case == "byte"] == [0x2A, 1, 2, 3]
    assert board.processor.memory.read(board.image.symbols["in"].address, 5) == bytes([0xA5] * 5)


TOGGLING = (
    HEAD
    + """
static const unsigned blue = 1u << 21;
int main(void) {
    begin();
    WORD(0x40048038) |= 1u << 10; WORD(0x4004803C) |= 1u << 23;
    WORD(0x4004A054) = 0x100; WORD(0x400FF044) = blue; WORD(0x400FF054) = blue;
    BYTE(0x40021002) = 0xC0 | 60;
    set(2, (struct descriptor){.saddr = PTR(&blue), .attr = 0x0202, .nbytes = 4, .daddr = 0x400FF04C, .citer = 6,
        .biter = 6, .csr = 8});
    BYTE(0x4000801B) = 2;
    WORD(0x40037000) = 0; WORD(0x40037120) = 20971 - 1; WORD(0x40037128) = 1;
    SLEEP
}
"""
)


def test_a_timer_lets_one_request_through_at_each_expiry(build_c: Build) -> None:
    board = VirtualK64F(build_c(TOGGLING))
    board.run_until(0.05)
    toggles = [event.time_s for event in board.events if event.part == "LED blue"]
    assert len(toggles) == 6  # DREQ ends it
    # To the clock of the bus: nothing but the timer and the eDMA is at work.
    assert [later - earlier for earlier, later in itertools.pairwise(toggles)] == pytest.approx(
        [20971 / (640 * 32768)] * 5, abs=1e-9
    )


OVERWRITING = (
    HEAD
    + """
static const unsigned short returns[2][8] = {
    {0, 0, 0, 0, 0x2011, 0xBF00, 0x4770, 0}, {0, 0, 0, 0, 0x2022, 0x4900, 0x4770, 0},
};
volatile unsigned got[6];
__attribute__((aligned(8))) static unsigned short code[8];
int main(void) {
    begin();
    for (int i = 0; i < 6; i++) {
        set(0, (struct descriptor){.saddr = PTR(returns[i % 2]), .soff = 4, .attr = 0x0202, .nbytes = 16,
            .daddr = PTR(code), .doff = 4, .citer = 1, .biter = 1, .csr = 1});
        while (!(TCD(0)->csr & 0x80)) {}
        got[i] = ((unsigned (*)(void))(PTR(code + 4) | 1))();
    }
    SLEEP
}
"""
)


def test_code_that_is_moved_over_code_is_what_runs_and_what_is_counted(build_c: Build) -> None:
    board = ran(build_c(OVERWRITING), 0.01)
    assert board.processor.memory.read_words(board.image.symbols["got"].address, 6) == (0x11, 0x22) * 3
