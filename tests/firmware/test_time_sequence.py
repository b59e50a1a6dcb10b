"""TIME_SEQUENCE: sequences that reside in the firmware, from each memory, and the flash controller behind them."""

from __future__ import annotations

import re
import struct

import pytest

from hiltest.link.framing import Frame, encode_frame
from hiltest.link.replies import Status
from hiltest.link.sequences import SEQUENCES, SequencePlace, TimeSequence
from hiltest.virtual.core.library import lib
from hiltest.virtual.peripherals.bus import StoredRegisters
from hiltest.virtual.processor.nvic import INTERRUPTS
from hiltest.virtual.program.elf import load_image

from ..virtual.oracle import Step, watched
from .bench import CLEAR_POINTS, ELF, ROOT, Bench

TIME_SEQUENCE = TimeSequence.code
PAGE = (ROOT / "firmware_stub" / "PROTOCOL.md").read_text(encoding="utf-8")
PFB0CR, PFB1CR = 0x4, 0x8
UART0_INTERRUPT = 16 + 31
FLASH_LINE = 16  # bytes


def cycles(bench: Bench, sequence: int, place: int) -> tuple[int, int]:
    cost, overhead = struct.unpack("<2I", bench.ask(TIME_SEQUENCE, bytes([sequence, place])))
    return cost, overhead


def test_the_firmware_has_the_sequences_that_the_host_and_the_page_list_and_no_other() -> None:
    bench = Bench()
    assert bench.status(TIME_SEQUENCE, bytes([len(SEQUENCES) - 1, 0])) is Status.OK
    assert bench.status(TIME_SEQUENCE, bytes([len(SEQUENCES), 0])) is Status.BAD_ARGUMENT
    assert bench.status(TIME_SEQUENCE, bytes([0, len(SequencePlace)])) is Status.BAD_ARGUMENT
    listed = re.findall(r"^\| (\d+) \| ([a-z_]+) \| ", PAGE, re.M)
    assert listed == [(str(number), name) for number, name in enumerate(SEQUENCES)]
    assert f"| TIME_SEQUENCE | u8 sequence, u8 place (0..{max(SequencePlace)}) |" in PAGE


def test_each_is_in_sram_and_in_flash_in_this_order() -> None:
    symbols = load_image(ELF).symbols
    for place, memory in (("sram", range(0x1FFF0000, 0x20000000)), ("flash", range(0x100000))):
        at = [symbols[f"sequence_{name}_{place}"].address for name in SEQUENCES]
        assert at == sorted(at)
        assert all(address in memory for address in at)


@pytest.mark.parametrize("place", SequencePlace)
def test_additions_cost_a_clock_each_and_a_run_more_than_those_of_its_half(place: SequencePlace) -> None:
    cost, second_half = cycles(Bench(), SEQUENCES.index("data"), place)
    assert cost == 32
    assert 32 < second_half < 100


def two_runs(bench: Bench, number: int, memory: str, executed: list[int]) -> tuple[list[int], list[int]]:
    """Where instructions stand that a run of the second half executes, and one of the whole."""
    executed.clear()
    cycles(bench, number, SequencePlace[memory.upper()])
    begin = bench.board.image.symbols[f"sequence_{SEQUENCES[number]}_{memory}"].address & ~1
    assert executed.count(begin) == 1
    whole = executed.index(begin)
    return executed[:whole], executed[whole:]


@pytest.mark.parametrize("memory", ["sram", "flash"])
def test_a_run_of_the_second_half_begins_and_ends_as_one_of_the_whole(memory: str) -> None:
    bench = Bench()
    executed: list[int] = []
    first, last = (bench.board.image.symbols[f"sequence_{SEQUENCES[item]}_{memory}"] for item in (0, -1))
    within = range(first.address & ~1, (last.address & ~1) + last.size)

    def tell(step: Step) -> None:
        """Keep what is executed of the sequences."""
        if step.instruction.address in within:
            executed.append(step.instruction.address)

    for number in range(len(SEQUENCES)):
        with watched(bench.board) as oracle:
            oracle.tell = tell
            half, whole = two_runs(bench, number, memory, executed)
        added = len(whole) - len(half)
        assert whole[added:] == half
        start, middle = whole[0], half[0]
        assert [start % FLASH_LINE, middle % FLASH_LINE] == [0, 0]
        # Neither is in the line behind the callee, which flash reads ahead.
        assert all(start // FLASH_LINE > address // FLASH_LINE + 1 for address in whole if address < start)
        # Both halves are alike, but for the callee before them.
        first_half = [address + middle - start if address >= start else address for address in whole[:added]]
        assert first_half == half[:added]


@pytest.mark.parametrize("place", SequencePlace)
def test_exceptions_cost_what_the_profile_says_beside_what_makes_and_ends_them(place: SequencePlace) -> None:
    bench = Bench()
    profile = bench.board.processor.profile
    rows = {name: row.value for name, row in profile.rows.items()}
    readings = 8 * (rows["load"] + rows["system"])
    assert cycles(bench, SEQUENCES.index("readings"), place) == (readings, readings)
    entry = readings + 8 * profile.rows["exception_entry"].value
    assert cycles(bench, SEQUENCES.index("exception_entry"), place) == (entry, entry)
    leaving = rows["branch"] + rows["refill_indirect"] - rows["system"]
    remainder = readings + 8 * (profile.rows["exception_return"].value + leaving)
    assert cycles(bench, SEQUENCES.index("exception_return"), place) == (remainder, remainder)


@pytest.mark.parametrize("name", ["stores", "exception_entry", "exception_return"])
def test_an_interrupt_that_comes_during_a_sequence_waits_until_it_is_over(name: str) -> None:
    undisturbed = cycles(Bench(), SEQUENCES.index(name), SequencePlace.SRAM)
    bench = Bench()
    processor = bench.board.processor
    nvic, at = processor.nvic, bench.board.image.symbols[f"sequence_{name}_sram"].address & ~1
    enabled = [nvic.is_enabled(interrupt) for interrupt in range(INTERRUPTS)]
    came: list[int] = []

    def interrupt(_reason: int) -> None:
        """Have UART0 ask for attention within the sequence."""
        came.append(processor.core.r[15])
        nvic.pend(UART0_INTERRUPT)
        processor.core.passes_breakpoint = True

    processor.at_stop = interrupt
    assert lib.machine_set_breakpoint(processor.machine.handle, at, True)
    assert cycles(bench, SEQUENCES.index(name), SequencePlace.SRAM) == undisturbed
    assert set(came) == {at}
    assert UART0_INTERRUPT not in nvic.pending  # it was served, later
    assert [nvic.is_enabled(interrupt) for interrupt in range(INTERRUPTS)] == enabled
    assert any(enabled)


def test_a_supervisor_call_of_no_sequence_ends_as_every_unexpected_exception() -> None:
    bench = Bench()
    memory, symbols = bench.board.processor.memory, bench.board.image.symbols
    bench.ask(TIME_SEQUENCE, bytes([SEQUENCES.index("exception_entry"), 0]))
    memory.write(symbols["command_clear_points"].address & ~1, b"\x00\xdf")  # SVC 0
    bench.send(encode_frame(Frame(CLEAR_POINTS, 77, b"")))
    bench.board.run_until(bench.board.time_s + 0.1)
    marker, cause, exception = memory.read_words(symbols["fault_record"].address, 3)
    assert (marker, cause, exception) == (0x4C544146, 1, 11)


def test_the_flash_controller_forgets_what_it_held_before_a_run_and_is_switched_off_under_it_where_asked() -> None:
    bench = Bench()
    (controller,) = (
        peripheral
        for peripheral in bench.board._chip._peripherals
        if isinstance(peripheral, StoredRegisters) and peripheral.name == "FMC"
    )
    written: list[tuple[int, int]] = []
    write = controller.write

    def note(offset: int, size: int, value: int) -> None:
        """Keep what the firmware writes."""
        written.append((offset, value))
        write(offset, size, value)

    controller.write = note  # type: ignore[method-assign]
    before = controller.word(PFB0CR), controller.word(PFB1CR)
    # From SRAM as well: the vector of the exceptions that sequences make there is in flash.
    for place, under_it in (
        (SequencePlace.SRAM, 0x1F),
        (SequencePlace.FLASH, 0x1F),
        (SequencePlace.FLASH_ALONE, 0),
        (SequencePlace.FLASH_WITHOUT_CACHE, 0x07),
        (SequencePlace.FLASH_WITHOUT_PREFETCH, 0x19),
    ):
        written.clear()
        cycles(bench, 1, place)
        assert (controller.word(PFB0CR), controller.word(PFB1CR)) == before
        # Twice, for its second half before the whole: all on or off, and what buffers and cache held forgotten.
        assert [offset for offset, _ in written] == 2 * [PFB0CR, PFB1CR, PFB0CR, PFB1CR]
        assert [value & 0x1F for _, value in written] == 2 * [under_it, under_it, 0x1F, 0x1F]
        assert [value >> 19 & 0x1F for _, value in written] == 2 * [0x1F, 0, 0, 0]  # bank 1 has no such bits


def test_a_core_without_a_cycle_counter_says_so() -> None:
    bench = Bench(cycle_counter=False)
    reply = bench.request(TIME_SEQUENCE, bytes([1, 0])).payload
    assert (Status(reply[0]), reply[1:]) == (Status.NO_CYCLE_COUNTER, bytes(8))
