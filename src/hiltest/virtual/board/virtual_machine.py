"""A virtual board: a chip with its memories, the LEDs and buttons around it, and the parts on its buses."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

from hiltest.errors import ConfigError, SnapshotError
from hiltest.state import HasState
from hiltest.virtual.board.cortex_m4 import VirtualCortexM4
from hiltest.virtual.board.interrupt_wires import InterruptSource, InterruptWires
from hiltest.virtual.board.leds_and_buttons import BoardEvent, LedsAndButtons
from hiltest.virtual.board.loading import load_segments, vectors
from hiltest.virtual.board.machine_chip import ChipClocks, MachineChip, SerialLine
from hiltest.virtual.core.machine import Snapshot
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE
from hiltest.virtual.model.timing import TimingProfile
from hiltest.virtual.part.chip import MemoryMap
from hiltest.virtual.peripherals.i2c_bus import HeldLine
from hiltest.virtual.peripherals.rcm import ResetRequested, ResetSource
from hiltest.virtual.processor.clock import PICOSECONDS
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.interrupt import deferred_interrupt
from hiltest.virtual.processor.schedule import Event
from hiltest.virtual.program.elf import FirmwareImage


@dataclass(frozen=True, slots=True, eq=False)
class BoardSnapshot:
    """State of a board and of the parts on its buses at one moment, taken by `VirtualMachine.snapshot`."""

    board: VirtualMachine
    machine: Snapshot
    parts: tuple[tuple[HasState, Any], ...]
    is_booted: bool


class VirtualMachine(VirtualCortexM4):
    """A board that runs an image, instruction by instruction, with a cycle count.

    Parameters
    ----------
    elf
        File, or its content: firmware for the chip, as ELF, Intel HEX or raw binary at 0. For a binary at another
        address, pass `load_image(path, base=0x8000)`.
    profile
        Name of a profile, or a user's own file (``.toml``), see `hiltest.virtual.model.profile_file`.
    memory
        Memories of the chip.
    chip
        Connects the peripherals of the chip to the processor.
    core
        Name of its core.

    Attributes
    ----------
    title : str
        Name of the board, for people.
    run_processor : callable
        Runs the processor as `Processor.run` does; a debugger replaces it.
    debugged : bool
        True while a debugger is connected.
    access : threading.RLock
        Held during a reset, and by a debugger while it reads or writes, so that it never sees half a reset.
    halted_s : float
        Wall time that the board has been halted so far [s].

    Raises
    ------
    ConfigError
        If the image is not for this processor or does not fit its memories.
    """

    title: ClassVar[str]
    _chip: MachineChip
    _leds_and_buttons: LedsAndButtons

    def __init__(
        self,
        elf: str | Path | bytes | FirmwareImage,
        *,
        profile: str | TimingProfile = DEFAULT_PROFILE,
        memory: MemoryMap,
        chip: Callable[[Processor], MachineChip],
        core: str = "cortex-m4",
    ) -> None:
        super().__init__(elf, profile=profile, memory=memory, part=chip, core=core)
        self._wires: list[InterruptWires] = []
        self.run_processor = self.processor.run
        self.debugged, self.halted_s = False, 0.0
        self.access = threading.RLock()

    # -- reset --------------------------------------------------------------------------------

    def boot(self) -> None:
        """Power on: the next `run_until` starts the firmware from its vector table."""
        with self.access, deferred_interrupt(lambda: None):
            load_segments(self.processor.memory, self.image)
            self._chip.power_on(self.image.segments)
            self._chip.watchdog_resets = 0
            self._reset(ResetSource.POWER_ON)
            self.processor.delivers_faults = True
            self._booted = True

    def reset(self) -> None:
        """Press and release the reset button: the firmware restarts, and time continues."""
        self._reset(ResetSource.PIN)

    def reset_at(self, time_s: float, source: ResetSource) -> None:
        """Reset the board at a virtual time, by its reset button or a power cycle."""

        def reset() -> None:
            raise ResetRequested(source)

        self.clocks.time.call_at(math.ceil(Fraction(time_s) * PICOSECONDS), reset)

    def _reset(self, source: ResetSource) -> None:
        processor = self.processor
        with self.access, deferred_interrupt(lambda: None):  # half a reset would execute the vector table as code
            processor.reset()
            self._chip.reset(source)
            stack, entry = vectors(processor.memory, self.image)
            processor.core.vector_table = self.image.vectors
            processor.core.r[13], processor.core.r[15] = stack & ~3, entry & ~1

    # -- time ---------------------------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Virtual time since power-on [s]."""
        return self.clocks.time_s()

    def run_until(self, time_s: float, *, wake: Callable[[], bool] | None = None, for_bytes: bool = False) -> None:
        """Run the firmware until virtual time `time_s`, or until `wake` returns true.

        Parameters
        ----------
        time_s
            Virtual time since power-on [s].
        wake
            Called after every event of a peripheral.
        for_bytes
            True if `wake` need not be called before the bytes that `Uart.host_expect` describes have arrived.

        Raises
        ------
        BoardFault
            If the processor faults or hangs.
        ConfigError
            If the image has no vector table to boot from.
        """
        if not self._booted:
            self.boot()
        until = self._moment(time_s)
        try:
            while True:
                try:
                    self.run_processor(until, wake=wake, for_bytes=for_bytes)
                    return
                except ResetRequested as request:
                    fault = self.processor.fault_log.first_cause
                    if request.source is ResetSource.POWER_ON:
                        self.boot()
                    else:
                        self._reset(request.source)
                    if fault is not None:
                        raise fault.ended(str(request)) from None
        finally:
            until.cancel()

    def _moment(self, time_s: float) -> Event:
        """Return an event at a virtual time, which stays correct if the clocks change before it."""
        if not math.isfinite(time_s):
            return Event(math.inf)
        until = math.ceil(Fraction(time_s) * PICOSECONDS)
        return self.clocks.time.call_at(until, lambda: None, wakes=False)

    def _call_hz(self, requested_hz: float | None) -> float:
        if not self._booted:
            return super()._call_hz(requested_hz)
        if requested_hz is not None:
            raise ConfigError(
                f"clock_hz={requested_hz} is for functions called without boot; the running firmware has set up "
                f"{self.clocks.core_hz / 1e6:g} MHz: omit clock_hz"
            )
        return self.clocks.core_hz

    # -- snapshots ----------------------------------------------------------------------------

    def snapshot(self) -> BoardSnapshot:
        """Return the state of processor, memories, peripherals and the parts on the buses, for `restore`.

        It contains neither the host's end of the serial lines, nor the world that sensors measure, nor earlier
        recordings and counts. `VirtualBench.snapshot` also contains the world.

        Raises
        ------
        SnapshotError
            If the board is running, if bytes of the host are on a line towards it, or if a file stores the board's
            flash.
        """
        self._refuse_if_running()
        for uart in self.uarts:
            if uart.host_arriving:
                count = f"{uart.host_arriving} bytes of the host are on the line to {uart.name}"
                raise SnapshotError(f"a request is open: {count}; run the board until it has answered")
        machine = self.processor.machine.snapshot(with_devices=True)
        return BoardSnapshot(self, machine, tuple((part, part.state()) for part in self._stateful()), self._booted)

    def restore(self, snapshot: BoardSnapshot) -> None:
        """Return to a snapshot of this board, from which the board repeats its actions.

        Afterwards the serial lines are empty: bytes that the host has not fetched are lost, and a host that numbers its
        requests must synchronise again (`Session.synchronise`). Calls of watched functions that were open at the
        snapshot are not counted.

        Raises
        ------
        SnapshotError
            If the snapshot belongs to another board, or the board is running.
        """
        if snapshot.board is not self:
            raise SnapshotError("the snapshot belongs to another board; a board can restore only its own snapshots")
        self._refuse_if_running()
        self.processor.machine.restore(snapshot.machine)
        for part, state in snapshot.parts:
            part.restore(state)
        self._booted = self.processor.delivers_faults = snapshot.is_booted

    def _refuse_if_running(self) -> None:
        if self.processor.is_running:
            raise SnapshotError("the board is running; wait until `run_until` or `call` has returned")

    def _stateful(self) -> list[HasState]:
        """Return the stateful objects other than the core and its peripherals in C."""
        return [self._chip, self._leds_and_buttons, *self._wires, self.processor.fault_log, self.processor.waiting]

    def unanswered_part(self) -> str:
        """Return a sentence about a part that firmware asked only while the part was booting; empty without one."""
        buses = enumerate(self._chip.i2c_buses)
        asked = [(bus, number, address, time) for number, bus in buses for address, time in bus.booting.items()]
        if not asked:
            return ""
        bus, number, address, time_s = asked[0]
        return (
            f"the {bus.part_name(address)} on I2C{number} was still booting when the firmware asked it, "
            f"{1e3 * time_s:.1f} ms after power-on, and it was not asked again. On a bench the debugger's reset hides "
            "this, because the part is powered before. Reset the board (M8 at hiltest serve, faults.reset in a rig), "
            "or let the firmware wait"
        )

    # -- peripherals of the chip --------------------------------------------------------------

    @property
    def clocks(self) -> ChipClocks:
        """The clocks that the firmware has set up, and virtual time."""
        return self._chip.clocks

    @property
    def uarts(self) -> Sequence[SerialLine]:
        """The serial ports, each with the far end of its wire: `host_write`, `host_read`, `line_baud`."""
        return self._chip.uarts

    @property
    def uart0(self) -> SerialLine:
        """The board's serial port."""
        return self._chip.uarts[0]

    @property
    def seed(self) -> int:
        """Seed of the chip's random number generator from now on; 0 if none is set."""
        return self._chip.random_numbers.seed

    @seed.setter
    def seed(self, seed: int) -> None:
        self._chip.random_numbers.seed = seed

    def set_temperature(self, temperature_degc: Callable[[], float]) -> None:
        """Set the function that returns the chip's temperature [degC]; the default is 25 degC."""
        self._chip.temperature_degc = temperature_degc

    # -- pins ---------------------------------------------------------------------------------

    @property
    def events(self) -> list[BoardEvent]:
        """Changes of LEDs and buttons since power-on."""
        return self._leds_and_buttons.events

    def press(self, button: str) -> None:
        """Press a button and hold it."""
        self._leds_and_buttons.push(button, True)

    def release(self, button: str) -> None:
        self._leds_and_buttons.push(button, False)

    def is_on(self, name: str) -> bool:
        """Return whether an LED is lit or a button is pressed."""
        return self._leds_and_buttons.is_on(name)

    def display_rows(self) -> tuple[str, ...]:
        """Return the rows of the display, top first: ``#`` for an LED that is lit, ``.`` for another; empty without."""
        return ()

    def drive(self, pin: str, high: bool) -> None:
        """Drive a pin of the chip from outside, such as ``PTC5`` of the K64F."""
        port, number = self._chip.pin(pin)
        port.drive(number, high)

    def level(self, pin: str) -> bool:
        """Return the level of a pin, whatever drives it; low while the pin is analog."""
        port, number = self._chip.pin(pin)
        return bool(port.levels >> number & 1)

    def connect_interrupts(self, bus: str, part: InterruptSource, pins: Mapping[str, str]) -> None:
        """Connect the interrupt pins of a part.

        Parameters
        ----------
        bus
            Bus of the part, such as ``i2c1`` or ``spi0``.
        part
            A part that the constructor received for that bus.
        pins
            Pin of the chip, such as ``PTB9`` of the K64F, by pin of the part; the others stay open.
        """
        wires = InterruptWires(part, [self._wire_to(pins.get(pin)) for pin in part.pins], self.clocks.time)
        self._wires.append(wires)
        number = int(bus[-1])
        if bus.startswith("spi"):
            self._chip.spi_buses[number].call_after_stop(part, wires.update)
        else:
            self._chip.i2c_buses[number].call_after_stop(part, wires.update)
        wires.update()

    def update_interrupts(self) -> None:
        """Pass on the levels of all interrupt pins, after an access to a part that is not on its bus."""
        for wires in self._wires:
            wires.update()

    def _wire_to(self, pin: str | None) -> Callable[[bool], None] | None:
        """Return a function that sets the level of a pin from outside; None if there is no pin."""
        if pin is None:
            return None
        port, number = self._chip.pin(pin)
        return lambda high: port.drive(number, high)

    def hold_line(self, bus: int, hold: HeldLine) -> None:
        """Pull a line of an I2C bus low for a time, as a stuck part or a short circuit does."""
        self._chip.i2c_buses[bus].on_hold(hold)
