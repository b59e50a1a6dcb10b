"""Programs for the FRDM-K64F that others wrote: what each does on the board, and a run that looks whether it does.

    python -m tests.virtual.foreign [NAME ...]

prints a line for each program as it ends, and with --page writes docs/foreign-firmware.md. If a program is
missing, it says so and stops.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import pytest

from hiltest.boards.bench import VirtualBench
from hiltest.errors import BoardFault
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.board.k64f import VirtualK64F

from ..foreign_elf import foreign_elf

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"
_STEP_S = 0.002  # how often the line is looked at: times of what was said are this exact
_RATE_TOLERANCE = 0.01
_LONG_ENOUGH = 3  # periods that a rate is told from


@dataclass
class Seen:
    """What a program has said and shown.

    Attributes
    ----------
    output : bytearray
        Bytes of UART0.
    arrived : list of (float, int)
        Virtual time [s] and length of the output by then.
    toggles : dict of str to list of float
        Times at which each LED changed [s].
    fault : str
        What ended it, if something did.
    """

    output: bytearray = field(default_factory=bytearray)
    arrived: list[tuple[float, int]] = field(default_factory=list)
    toggles: dict[str, list[float]] = field(default_factory=dict)
    fault: str = ""

    @property
    def text(self) -> str:
        """Output as text."""
        return self.output.decode("latin-1")

    def times_of(self, pattern: str) -> list[float]:
        """When each match of a pattern was complete [s]."""
        ends = [match.end() for match in re.finditer(pattern, self.text)]
        return [next(at for at, length in self.arrived if length >= end) for end in ends]


Check = Callable[[Seen], str | None]
"""Says what is wrong, or None."""


def says(*patterns: str) -> Check:
    """Expect patterns in this order."""

    def check(seen: Seen) -> str | None:
        text, at = seen.text, 0
        for pattern in patterns:
            match = re.compile(pattern).search(text, at)
            if match is None:
                return f"no {pattern!r} behind {text[max(at - 40, 0) : at]!r}: {text[at : at + 200]!r}"
            at = match.end()
        return None

    return check


def _wrong_rate(case: str, times: list[float], period_s: float, spread_s: float = 0.0) -> str | None:
    gaps = [behind - before for before, behind in pairwise(times)]
    if len(gaps) < _LONG_ENOUGH:
        return f"{case} {len(times)} times"
    most_s = _RATE_TOLERANCE * period_s + spread_s + _STEP_S
    if max(abs(gap - period_s) for gap in gaps) > most_s:
        return f"{case} every {min(gaps):.4f} to {max(gaps):.4f} s, not {period_s} s"
    mean_s = sum(gaps) / len(gaps)
    within = abs(mean_s - period_s) <= _RATE_TOLERANCE * period_s + spread_s
    return None if within else f"{case} every {mean_s:.4f} s, not {period_s} s"


def says_every(pattern: str, period_s: float, *, late_s: float = 0.0) -> Check:
    """Expect a pattern again and again, within 1 % of a period, or up to `late_s` later."""
    middle_s = period_s + late_s / 2
    return lambda observed: _wrong_rate(f"says {pattern!r}", observed.times_of(pattern), middle_s, late_s / 2)


def toggles_every(led: str, period_s: float) -> Check:
    """Expect an LED to change within 1 % of a period."""
    return lambda observed: _wrong_rate(f"{led} toggles", observed.toggles.get(led, []), period_s)


def toggles(led: str) -> Check:
    """Expect an LED to change, at whatever rate a loop of instructions makes."""
    return lambda observed: None if len(observed.toggles.get(led, [])) > _LONG_ENOUGH else f"{led} does not toggle"


def sends_packets(rate_hz: float, types: set[int]) -> Check:
    """Expect frames between 0x7E of these types, those of type 1 at a rate."""

    def check(seen: Seen) -> str | None:
        frames = [frame for frame in bytes(seen.output).split(b"\x7e") if frame]
        results = {frame[0] for frame in frames}
        if not types <= results:
            return f"packets of types {sorted(results)}"
        begin, end = seen.arrived[0][0], seen.arrived[-1][0]
        rate = sum(frame[0] == 1 for frame in frames) / (end - begin)
        return None if abs(rate / rate_hz - 1) < 0.05 else f"{rate:.1f} packets of type 1 a second"

    return check


def reads_one_g(pattern: str, unit_g: float) -> Check:
    """Expect three accelerations that make 1 g within the part's offset (20 mg an axis) and sensitivity (2.5 %)."""

    def check(seen: Seen) -> str | None:
        matches = re.findall(pattern, seen.text)
        for x, y, z in matches:
            norm_g = math.hypot(float(x), float(y), float(z)) * unit_g
            if abs(norm_g - 1) > 0.06:
                return f"{norm_g:.3f} g"
        return None if len(matches) >= _LONG_ENOUGH else f"{len(matches)} readings"

    return check


@dataclass(frozen=True)
class Program:
    """One program.

    Attributes
    ----------
    name : str
        File without suffix.
    does : str
        What it does on a board, for the table.
    seconds : float
        Virtual time that is long enough to see it.
    checks : tuple of Check
    sends : tuple of (float, bytes)
        What is typed, and when [s].
    sensors : bool
        Whether the bench's sensors are on the buses.
    """

    name: str
    does: str
    seconds: float
    checks: tuple[Check, ...]
    sends: tuple[tuple[float, bytes], ...] = ()
    sensors: bool = False

    @property
    def path(self) -> Path:
        """ELF file; `foreign_elf` skips the test if it is missing."""
        return foreign_elf(f"{self.name}.elf")


def _typed(text: str, first_s: float, gap_s: float = 0.02) -> tuple[tuple[float, bytes], ...]:
    """Type one character after the other."""
    return tuple((first_s + gap_s * index, character.encode()) for index, character in enumerate(text))


PROGRAMS = (
    Program("nxp_hello_world", "greets, then echoes", 0.5, (says("hello world.\r\n", "abc"),), _typed("abc", 0.1)),
    Program(
        "nxp_shell",
        "a shell with help, exit, led",
        1.5,
        (says(r"SHELL>> ", r"help", r"exit", r"led", r"SHELL>> "),),
        _typed("help\r", 0.1),
    ),
    Program("nxp_led_blinky", "LED toggles every second", 5.5, (toggles_every("LED red", 1.0),)),
    Program(
        "nxp_sensor_fusion",
        "packets at 40 Hz, green LED blinks",
        4.0,
        (sends_packets(40.0, {1, 2, 3, 4, 6, 7}), toggles("LED green")),
        sensors=True,
    ),
    Program("sdk_freertos_hello", "greets from a task", 0.1, (says("Hello world.\r\n"),)),
    Program("sdk_freertos_swtimer", "Tick. every second", 5.5, (says_every(r"Tick\.\r\n", 1.0),)),
    Program(
        "sdk_pit",
        "a timer's interrupt every second, LED toggles",
        5.5,
        (says("Starting channel No.0"), says_every("Channel No.0 interrupt is occurred", 1.0)),
    ),
    Program("sdk_lptmr", "LPTMR interrupts every second", 5.5, (says_every(r"LPTMR interrupt No\.\d+", 1.0),)),
    Program("sdk_ftm_timer", "- and a bar in turn, one a second", 5.5, (says_every(r"(?<=[\n|-])[-|]", 1.0),)),
    Program(
        "sdk_wdog",
        "refreshes a watchdog, is reset by it, ends at rest",
        15.0,
        (says("[Qq]uick test", "[Ww]indow mode", r"End of Wdog example!"),),
    ),
    Program("sdk_uart_interrupt", "echoes by interrupt", 0.5, (says("abcdefgh"),), _typed("abcdefgh", 0.1)),
    Program("sdk_uart_polling", "echoes by polling", 0.5, (says("abcdefgh"),), _typed("abcdefgh", 0.1)),
    Program(
        "sdk_edma_memory_to_memory",
        "copies by DMA",
        0.2,
        (says(r"0\s+0\s+0\s+0", "transfer example finish", r"1\s+2\s+3\s+4"),),
    ),
    Program("sdk_rnga_random", "ten random words", 0.2, (says(*[r"0x[0-9A-Fa-f]{2,8}"] * 10),)),
    Program(
        "sdk_crc",
        "five kinds of CRC",
        0.2,
        (says("0x29b1"), says("0x44c2"), says("0x2189"), says("0xcbf43926"), says("0x765e7680")),
    ),
    Program(
        "sdk_flash_pflash",
        "erases, programs and verifies a sector",
        2.0,
        (says("(?i)unsecure", "(?i)erase", "(?i)program", "End of PFlash Example"),),
    ),
    Program(
        "sdk_adc16_polling",
        "calibrates, converts on each key",
        0.5,
        (says(r"Calibration\(\) Done", r"ADC Value: \d+", r"ADC Value: \d+"),),
        _typed("ab", 0.1, 0.1),
    ),
    Program("sdk_mcg_fee_blpe", "changes from FEE to BLPE, LED blinks", 3.0, (toggles("LED red"),)),
    Program("z_hello", "greets", 0.1, (says("Hello World! frdm_k64f"),)),
    Program(
        "z_synchronization",
        "two threads say hello in turn, every half second",
        3.2,
        # Sleep ends with a tick of 10 ms.
        (says(*["threadA: Hello", "threadB: Hello"] * 3), says_every("thread[AB]: Hello", 0.5, late_s=0.01)),
    ),
    Program(
        "riot_hello",
        "greets, names board and CPU",
        0.1,
        (says("Hello World!", "frdm-k64f", "kinetis"),),
    ),
    Program(
        "riot_shell",
        "answers help and ps, reboots",
        1.0,
        (
            says(
                "help",
                "reboot",
                r"pid",
                "main",
                "This is RIOT",
            ),
        ),
        _typed("help\nps\nreboot\n", 0.1, 0.03),
    ),
    Program(
        "riot_thread_cooperation",
        "workers multiply a factorial",
        1.5,
        (says(r"\d+! = \d+", r"\[SUCCESS\]"),),
        _typed("s\n", 0.1),
    ),
    Program(
        "riot_msg_pingpong",
        "messages a second",
        2.5,
        (says(r'\{ "result" : \d{4,}'),),
        _typed("s\n", 0.1),
    ),
    # It ends so on any board: of the timer's 1 Hz it expects a neighbour that is not less than 1 - 2, unsigned.
    Program(
        "riot_timer",
        "channels fire at their times, then it fails on its own arithmetic",
        1.5,
        (says(*["TIMER", *[r"channel 0 fired", r"\[OK\] \(no spurious"] * 3] * 2, "TIMER 2", "15: 1", "main.c:278"),),
        _typed("s\n", 0.1),
    ),
    Program(
        "riot_ztimer_msg",
        "Hello World every 2 s, This is a Test every 5 s",
        16.5,
        (says_every("Hello World", 2.0), says("This is a Test", "This is a Test", "This is a Test")),
        _typed("s\n", 0.1),
    ),
    Program(
        "riot_fxos8700",
        "readings of 1 g and the field, each second",
        4.5,
        # Each second begins when the line before is printed: 70 characters at 115 200 baud.
        (
            says_every("acceleration", 1.0, late_s=0.02),
            reads_one_g(r"acceleration: \((-?\d+), (-?\d+), (-?\d+)\)", 0.001),
        ),
        sensors=True,
    ),
    Program("riot_hwrng", "random bytes, 1 to 64", 0.8, (says(r"0x[0-9a-f]{2}"),), _typed("s\n", 0.1)),
)


def program_named(name: str) -> Program:
    """Return a program of `PROGRAMS`."""
    return next(program for program in PROGRAMS if program.name == name)


def machine_for(program: Program) -> VirtualK64F:
    """Make the board of a program."""
    if program.sensors:
        return VirtualBench(load_rig(RIG), firmware=program.path).machine
    return VirtualK64F(program.path)


def watch(program: Program, machine: VirtualK64F, seconds: float | None = None) -> Seen:
    """Run a program, type what it waits for, and note what it does."""
    observed, sends, now = Seen(), list(program.sends), 0.0
    end = program.seconds if seconds is None else seconds
    while now < end and not observed.fault:
        now = min(now + _STEP_S, end)
        while sends and sends[0][0] <= now:
            machine.uart0.host_write(sends.pop(0)[1])
        try:
            machine.run_until(now)
        except BoardFault as error:
            observed.fault = str(error)
        if machine.uart0.host_waiting:
            observed.output += machine.uart0.host_read(machine.uart0.host_waiting)
            observed.arrived.append((now, len(observed.output)))
    for event in machine.events:
        observed.toggles.setdefault(event.part, []).append(event.time_s)
    return observed


@dataclass(frozen=True)
class Result:
    """What came of a program: what is wrong, or nothing."""

    program: Program
    virtual_s: float
    wall_s: float
    wrong: tuple[str, ...]

    @property
    def ratio(self) -> float:
        """Virtual against wall time."""
        return self.virtual_s / self.wall_s


def run(program: Program) -> Result:
    """Run a program to its end and look at what it did."""
    machine = machine_for(program)
    began = time.monotonic()
    observed = watch(program, machine)
    wall_s = time.monotonic() - began
    wrong = [result for check in program.checks if (result := check(observed)) is not None]
    wrong += [observed.fault] if observed.fault else []
    return Result(program, machine.time_s, wall_s, tuple(wrong))


def main() -> int:
    """Run the programs that were named, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--page", type=Path, help="write the table to this page")
    arguments = parser.parse_args()
    chosen = [
        program for program in PROGRAMS if not arguments.names or any(name in program.name for name in arguments.names)
    ]
    rows, failed = [], 0
    for program in chosen:
        try:
            result = run(program)
        except pytest.skip.Exception as missing:
            print(missing)
            return 1
        failed += bool(result.wrong)
        verdict = "; ".join(result.wrong) or "as it should be"
        print(f"{program.name:26} {result.virtual_s:6.2f} s {result.ratio:8.2f} x  {verdict}", flush=True)
        rows.append((program, result, verdict))
    if arguments.page:
        _write_page(arguments.page, rows)
    return 1 if failed else 0


def _write_page(path: Path, rows: list[tuple[Program, Result, str]]) -> None:
    """Put the table behind the page's first paragraph."""
    text = path.read_text(encoding="utf-8")
    head = text[: text.index("| program |")]
    lines = ["| program | what it does | virtual time | x real time | result |", "| --- | --- | --- | --- | --- |"]
    lines += [
        f"| {program.name} | {program.does} | {result.virtual_s:.1f} s | {result.ratio:.2g} | {verdict} |"
        for program, result, verdict in rows
    ]
    path.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
