"""Every peripheral goes back to a snapshot: the same accesses to its registers get the same answers again."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hiltest.boards import default_firmware
from hiltest.errors import BoardFault, ConfigError, HiltestError
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.part.chip import mk64f12
from hiltest.virtual.peripherals.rcm import ResetRequested
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.earth_field import EarthField
from hiltest.world.sensors.mag3110 import Mag3110
from hiltest.world.world import World

from ..sensors.bus_master import write

GATES = range(0x40048028, 0x40048044, 4)  # SCGC1 to 7
# Modules that are modelled, but for those that reset the chip or let it sleep.
MODELLED = {
    "ADC0",
    "ADC1",
    "CRC",
    "DMA",
    "DMAMUX",
    "FMC",
    "FTFE",
    "FTM0",
    "FTM3",
    "GPIOC",
    "I2C0",
    "I2C1",
    "LPTMR0",
    "MCG",
    "OSC",
    "PIT",
    "PMC",
    "PORTA",
    "PORTC",
    "RFSYS",
    "RFVBAT",
    "RNG",
    "RTC",
    "SIM",
    "SYSMPU",
    "UART0",
    "UART1",
    "UART5",
    "WDOG",
}
MODULES = {
    module.name: [(register.address, register.size) for register in module.registers]
    for module in mk64f12().peripherals
    if module.name in MODELLED
}
MODULES["SysTick"] = [(0xE000E010 + offset, 4) for offset in range(0, 12, 4)]
MODULES["NVIC"] = [(0xE000E000 + offset, 4) for offset in (*range(0x100, 0x120, 4), 0xD14, 0xDFC)]
MODULES["DWT"] = [(0xE0001000, 4), (0xE0001004, 4)]
ROUNDS, ACCESSES = 25, 8
LOOK = """
    function main
    function look
    ldr r0, =0x4004a000  // PORTB_PCR0
    ldr r0, [r0]
    bx lr
    .ltorg
    ends look
"""
BYTES = 1000  # more than come over a line meanwhile


class Bench:
    """A board that has booted, all of whose modules have clocks, with one of them to be accessed at random."""

    def __init__(self, module: str) -> None:
        self.board = VirtualK64F(default_firmware(), strict=True)
        self.board.run_until(0.02)
        for gate in GATES:
            self.board.bus.write(gate, 4, 0xFFFFFFFF)
        self._registers = MODULES[module]

    def access(self, choice: random.Random) -> object:
        """Read or write a register."""
        address, size = choice.choice(self._registers)
        value = choice.choice((0xFFFFFFFF, 1 << choice.randrange(32), choice.getrandbits(32))) & (1 << 8 * size) - 1
        try:
            if choice.random() < 0.5:
                return self.board.bus.read(address, size) & (1 << 8 * size) - 1
            return self.board.bus.write(address, size, value)
        except (HiltestError, ResetRequested) as error:
            return str(error)

    def outcome(self, seed: int) -> list[Any]:
        """Access registers, pins and serial lines at random, let time pass in between; return all that can be seen."""
        board, choice, outcome = self.board, random.Random(seed), list[Any]()
        for _ in range(ROUNDS):
            outcome += [self.access(choice) for _ in range(ACCESSES)]
            board.drive(choice.choice(("PTC5", "PTA19", "PTC6", "PTB9")), choice.random() < 0.5)
            board.uarts[choice.randrange(6)].host_write(b"x")
            try:
                board.run_until(board.time_s + choice.choice((1e-6, 1e-5, 1e-4, 1e-3)))
            except HiltestError as error:
                outcome.append(str(error))
            outcome += [(uart.name, uart.host_read(BYTES), uart.baud) for uart in board.uarts]
        core = board.processor.core
        return [*outcome, core.cycles, core.instructions, tuple(core.r), board.level("PTC5"), len(board.faults)]


@pytest.mark.parametrize("module", sorted(MODULES))
def test_accesses_get_the_same_answers_behind_a_restore(module: str) -> None:
    bench = Bench(module)
    for seed in range(3):
        bench.board.run_until(bench.board.time_s + 0.05)
        for uart in bench.board.uarts:
            uart.host_read(BYTES)
        snapshot = bench.board.snapshot()
        once = bench.outcome(seed)
        bench.outcome(seed + 100)
        bench.board.restore(snapshot)
        again = bench.outcome(seed)
        assert [pair for pair in zip(once, again, strict=True) if pair[0] != pair[1]] == []


def test_a_gate_that_was_closed_is_closed_again(build: Callable[..., Path]) -> None:
    board = VirtualK64F(build(LOOK, with_start=False))
    snapshot = board.snapshot()
    board.bus.write(GATES[4], 4, 1 << 10)  # SCGC5.PORTB
    assert board.call("look").value == 0
    board.restore(snapshot)
    with pytest.raises(BoardFault, match="PORTB while its clock gate in the SIM is closed"):
        board.call("look")


def test_the_peripherals_of_a_board_do_not_go_to_another_one() -> None:
    board, other = VirtualK64F(default_firmware()), VirtualK64F(default_firmware())
    with pytest.raises(ConfigError, match="has other memories or peripherals"):
        other.processor.machine.restore(board.snapshot().machine)


def test_the_wire_of_a_sensor_rises_again(build: Callable[..., Path]) -> None:
    part = Mag3110(World(EarthField(48.5, 62.0)), MagneticDistortion(), seed=1)
    board = VirtualK64F(build(LOOK.replace("function look", "function look\n b look")), i2c1=[part])
    board.run_until(0.001)
    assert write(part, 0.001, 0x10, 0x01)  # active: the first sample comes behind a period of 12.5 ms
    board.connect_interrupts("i2c1", part, {"INT1": "PTC5"})
    board.bus.write(0x4004B014, 4, 1 << 8)  # PORTC_PCR5: GPIO
    snapshot, levels = board.snapshot(), list[bool]()
    for _ in range(2):
        board.restore(snapshot)
        for time_s in (0.01, 0.03):
            board.run_until(time_s)
            levels.append(board.level("PTC5"))
    assert levels == [False, True] * 2


def test_a_request_for_dma_comes_again() -> None:
    board = VirtualK64F(default_firmware())
    (source,) = {module.requests[-1] for module in mk64f12().peripherals if module.name == "UART0"}
    board.bus.write(0x40021000, 1, 0x80 | source)  # DMAMUX_CHCFG0
    board.uart0.write(0xB, 1, 0x80)  # C5.TDMAS
    snapshot, requested = board.snapshot(), list[int]()
    for _ in range(2):
        board.restore(snapshot)
        requested.append(board.bus.read(0x40008034, 4))  # DMA_HRS
        board.uart0.write(0x3, 1, 0x88)  # C2: TIE, TE
        requested.append(board.bus.read(0x40008034, 4))
    assert requested == [0, 1] * 2
