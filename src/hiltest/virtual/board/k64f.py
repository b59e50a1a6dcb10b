"""The virtual FRDM-K64F: memories and peripherals of the MK64FN1M0, LEDs, buttons and sensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from hiltest.virtual.board.cortex_m4 import VirtualCortexM4, open_image
from hiltest.virtual.board.frdm_k64f import FrdmLedsAndButtons
from hiltest.virtual.board.memory_map import memory_map
from hiltest.virtual.board.microcontroller import Microcontroller
from hiltest.virtual.board.virtual_machine import VirtualMachine
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE
from hiltest.virtual.model.timing import TimingProfile
from hiltest.virtual.part.part_file import Part
from hiltest.virtual.peripherals.i2c_bus import I2cDevice
from hiltest.virtual.peripherals.pit import PeriodicTimers
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.peripherals.spi_bus import SpiDevice
from hiltest.virtual.peripherals.uart import Uart
from hiltest.virtual.peripherals.wdog import Watchdog
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.memory import MK64FN1M0
from hiltest.virtual.program.elf import FirmwareImage
from hiltest.virtual.program.other_chips import other_chip, refuse_other_chip

_WAITING_SHARE = 0.9  # of instructions that are passed over, if firmware does nothing but wait


class VirtualK64F(VirtualMachine):
    """A board that runs an ELF, instruction by instruction, with a cycle count.

    Virtual time follows the clocks that the firmware sets up: after reset the core
    runs at 20.97 MHz.

    Parameters
    ----------
    elf
        File, or its content: firmware linked for the MK64FN1M0, as ELF, Intel HEX or raw binary at 0. For a binary
        at another address, pass `load_image(path, base=0x8000)`.
    i2c0, i2c1
        Parts on the two buses.
    spi0, spi1, spi2
        Parts on these buses, by the pin that selects each, such as ``PTD0``.
    profile
        Name of a profile, or a user's own file (``.toml``), see `hiltest.virtual.model.profile_file`.
    strict
        True if an access to an unmodelled peripheral of the chip is a bus error. Otherwise its registers store writes,
        and `unmodelled` lists those that were accessed.
    flash_file
        File that stores the flash between runs. At power-on, sectors without data of the image are loaded from it.

    Raises
    ------
    ConfigError
        If the ELF is for another processor or chip, or does not fit the memories.
    """

    title = "FRDM-K64F"
    _chip: Microcontroller

    def __init__(
        self,
        elf: str | Path | bytes | FirmwareImage,
        *,
        i2c0: Sequence[I2cDevice] = (),
        i2c1: Sequence[I2cDevice] = (),
        spi0: Mapping[str, SpiDevice] = MappingProxyType({}),
        spi1: Mapping[str, SpiDevice] = MappingProxyType({}),
        spi2: Mapping[str, SpiDevice] = MappingProxyType({}),
        profile: str | TimingProfile = DEFAULT_PROFILE,
        strict: bool = False,
        flash_file: str | Path | None = None,
    ) -> None:
        def microcontroller(processor: Processor) -> Microcontroller:
            self._chip = Microcontroller(
                processor, (i2c0, i2c1), (spi0, spi1, spi2), strict=strict, flash_file=flash_file
            )
            return self._chip

        image = open_image(elf)
        refuse_other_chip(image)
        super().__init__(image, profile=profile, memory=MK64FN1M0, chip=microcontroller)
        self._leds_and_buttons = FrdmLedsAndButtons(self._chip.ports, self.clocks.time_s)
        self._looked_at = 0, 0  # instructions executed, and those of waiting loops that were passed over

    def run_until(self, time_s: float, *, wake: Callable[[], bool] | None = None, for_bytes: bool = False) -> None:
        """Run the firmware as `VirtualMachine.run_until` does, and report a wait for interrupts that never come."""
        try:
            super().run_until(time_s, wake=wake, for_bytes=for_bytes)
        finally:
            self._report_silent_wait()

    def _report_silent_wait(self) -> None:
        """Report once if firmware waits while interrupts are enabled that never come."""
        core = self.processor.core
        executed, passed = core.instructions - self._looked_at[0], core.passed - self._looked_at[1]
        self._looked_at = core.instructions, core.passed
        if core.sleeping or (passed > 0 and passed > _WAITING_SHARE * executed):
            self._chip.unmodelled.report_interrupts(self._chip.silent_interrupts(), core.r[15])

    @property
    def clocks(self) -> ClockGates:
        """The clocks that the firmware has set up, and virtual time."""
        return self._chip.clocks

    @property
    def uarts(self) -> tuple[Uart, ...]:
        """UART0 to UART5, each with the far end of its wire: `host_write`, `host_read`, `line_baud`."""
        return self._chip.uarts

    @property
    def uart0(self) -> Uart:
        """UART0, the board's serial port."""
        return self._chip.uarts[0]

    @property
    def timers(self) -> PeriodicTimers:
        """The PIT."""
        return self._chip.timers

    @property
    def watchdog(self) -> Watchdog:
        return self._chip.watchdog

    @property
    def adc_volts(self) -> dict[tuple[int, int], float]:
        """Input voltages of the converters by converter and channel, such as ``adc_volts[0, 12] = 1.2``.

        The voltage of a differential channel is the one between its pins. Inputs without an entry have 0 V.
        """
        return self._chip.adc_volts


def board_for(
    elf: str | Path | bytes | FirmwareImage,
    *,
    profile: str | TimingProfile = DEFAULT_PROFILE,
    memory: str | None = None,
    part: Part | None = None,
) -> VirtualCortexM4:
    """Return a board that can call functions of an image: a `VirtualK64F` if the image is for the MK64FN1M0.

    If the image is for another chip, or `memory` or `part` names its memories, the board is a `VirtualCortexM4`.
    """
    image = open_image(elf, core=part.core) if part is not None else open_image(elf)
    if part is not None:
        memories = part.memory_map or memory_map(image, memory)
        return VirtualCortexM4(image, profile=profile, memory=memories, stack="image")
    memories = memory_map(image, memory)
    if memories == MK64FN1M0 and other_chip(image) is None:
        return VirtualK64F(image, profile=profile)
    return VirtualCortexM4(image, profile=profile, memory=memories)
