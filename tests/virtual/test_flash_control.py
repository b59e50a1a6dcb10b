"""The FMC's registers switch what makes flash fast, each bit its own part, and forget what they are told to forget."""

from __future__ import annotations

import pytest

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.model.profile_file import load_profile
from hiltest.virtual.peripherals.fmc import FlashControl

from .conftest import SHIPPED
from .core.memory_model import FlashController

FMC = 0x4001F000
PFAPR, PFB0CR, PFB1CR = 0x0, 0x4, 0x8
SEBE, IPE, DPE, ICE, DCE = (1 << bit for bit in range(5))
EVERYTHING = SEBE | IPE | DPE | ICE | DCE
S_B_INV, CINV_WAYS, M0PFD = 1 << 19, 0xF << 20, 1 << 16
BANK_1 = 0x80000
MISS = 5  # clocks of one that begins with the flash's clock, as each here does
A_WHILE = 1000  # cycles, whole clocks of the flash; longer than anything waits


class Flash:
    """The controller of a board with memories, behind its registers."""

    def __init__(self, switches: int = EVERYTHING, bank: int = PFB0CR) -> None:
        self.controller = FlashController(load_profile("cortex-m4-k64f/1").memory)
        self.registers = FlashControl(self.controller)
        self.cycle = 0
        self.write(bank, switches)

    def write(self, register: int, value: int, size: int = 4) -> None:
        self.registers.write(register, size, value)

    def fetch(self, address: int, size: int = 4) -> int:
        self.cycle += A_WHILE
        return self.controller.wait(address, size, self.cycle)

    def load(self, address: int) -> int:
        self.cycle += A_WHILE
        return self.controller.wait(address, 4, self.cycle, fetched=False)


def test_out_of_reset_everything_is_on_and_the_width_and_the_wait_states_are_the_chips() -> None:
    flash = Flash()
    assert [flash.registers.word(register) for register in (PFAPR, PFB0CR, PFB1CR)] == [0xF8003F, *2 * [0x3004001F]]
    assert [flash.fetch(0x1000 + offset) for offset in (0, 4, 8, 12, 16)] == [MISS, 0, 0, 0, 0]


@pytest.mark.parametrize(("switch", "behind_code", "behind_data"), [(IPE, 0, MISS), (DPE, MISS, 0), (IPE | DPE, 0, 0)])
def test_the_next_line_is_read_behind_what_the_switch_says(switch: int, behind_code: int, behind_data: int) -> None:
    flash = Flash(switch)
    assert [flash.fetch(0x1000), flash.fetch(0x1010)] == [MISS, behind_code]
    flash.write(PFB0CR, switch | S_B_INV)
    assert [flash.load(0x2000), flash.load(0x2010)] == [MISS, behind_data]


def test_nothing_is_read_ahead_for_a_master_that_must_not() -> None:
    flash = Flash(IPE | DPE)
    flash.write(PFAPR, M0PFD | 0x3F)
    assert [flash.fetch(0x1000), flash.fetch(0x1010), flash.load(0x2000), flash.load(0x2010)] == 4 * [MISS]


@pytest.mark.parametrize(("switch", "code_again", "data_again"), [(ICE, 0, MISS), (DCE, MISS, 0), (ICE | DCE, 0, 0)])
def test_the_cache_keeps_what_the_switch_says(switch: int, code_again: int, data_again: int) -> None:
    flash = Flash(switch)
    assert [flash.fetch(0x1000), flash.load(0x2008)] == [MISS, MISS]
    flash.fetch(0x3010)  # a fetch of another word
    assert [flash.fetch(0x1000), flash.load(0x2008)] == [code_again, data_again]


def test_what_the_cache_holds_is_found_while_it_is_off_until_its_ways_are_forgotten() -> None:
    flash = Flash(ICE)
    flash.fetch(0x1000)
    flash.write(PFB0CR, 0)
    flash.fetch(0x3010)
    assert flash.fetch(0x1000) == 0
    flash.write(PFB0CR, CINV_WAYS)
    flash.fetch(0x3010)
    assert flash.fetch(0x1000) == MISS


def test_one_way_is_forgotten_alone_and_filled_next() -> None:
    flash, lines = Flash(ICE), [0x1000, 0x2000, 0x3000, 0x4000, 0x5000]  # all in one set of four ways
    for address in lines[:4]:
        flash.fetch(address)
    flash.write(PFB0CR, ICE | 1 << 22)  # the third way, which holds the third
    flash.fetch(lines[4])
    assert [flash.fetch(address) for address in (*lines[:2], lines[3], lines[4], lines[2])] == [0, 0, 0, 0, MISS]


@pytest.mark.parametrize(("off", "waits"), [(PFB0CR, [MISS, MISS, MISS, 0]), (PFB1CR, [MISS, 0, MISS, MISS])])
def test_each_half_of_the_flash_has_switches_of_its_own(off: int, waits: list[int]) -> None:
    flash = Flash(0, bank=off)
    assert [flash.fetch(address) for address in (0x1000, 0x1004, BANK_1, BANK_1 + 4)] == waits


def test_what_is_no_switch_stays_and_what_forgets_reads_as_zero() -> None:
    flash = Flash()
    for register, remainder in ((PFAPR, 0x00FFFFFF), (PFB0CR, 0x3F0400FF), (PFB1CR, 0x3004001F)):
        flash.write(register, 0xFFFFFFFF)
        assert flash.registers.read(register, 4) == remainder
        flash.write(register, 0)
        assert flash.registers.read(register, 4) == (0x30040000 if register else 0)


def test_a_byte_of_a_register_is_written_alone() -> None:
    flash = Flash(ICE | IPE)
    flash.fetch(0x1000)
    flash.write(PFB0CR + 2, 0xF0, size=1)  # forgets the ways
    flash.write(PFB0CR, ICE, size=1)
    assert flash.registers.word(PFB0CR) == 0x30040000 | ICE
    flash.fetch(0x3000)
    assert [flash.fetch(0x1000), flash.fetch(0x1010)] == [MISS, MISS]


def test_a_reset_switches_everything_on() -> None:
    flash = Flash(0)
    flash.registers.reset()
    assert [flash.fetch(0x1000), flash.fetch(0x1004), flash.fetch(0x1010)] == [MISS, 0, 0]


def test_the_registers_switch_what_calls_wait_for() -> None:
    def crc32_cycles(control: int) -> int:
        board.bus.write(FMC + PFB0CR, 4, control | S_B_INV | CINV_WAYS)
        return board.call("crc32", 5 * b"123456789", 45).cycles

    board = VirtualK64F(SHIPPED, profile="cortex-m4-k64f/3")
    switches = (EVERYTHING, ICE | DCE, SEBE, 0, EVERYTHING)
    fast, cached, buffered, slow, again = (crc32_cycles(control) for control in switches)
    assert fast < cached < buffered < slow
    assert abs(again - fast) < MISS  # a read may begin at another cycle of the flash's clock


def test_if_flash_waits_for_nothing_the_registers_are_kept_alike() -> None:
    board = VirtualK64F(SHIPPED)
    board.bus.write(FMC + PFB0CR, 4, CINV_WAYS | S_B_INV | SEBE)
    assert board.bus.read(FMC + PFB0CR, 4) == 0x30040000 | SEBE
