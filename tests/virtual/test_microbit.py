"""Debian's MicroPython on the virtual micro:bit: its prompt, its sensors, its display and its files."""

from __future__ import annotations

from ast import literal_eval
from collections.abc import Iterator
from pathlib import Path

import pytest

from hiltest.boards.bench import VirtualBench
from hiltest.orientation.angles import Pose
from hiltest.rig.rig_file import load_rig

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "microbit-v1.toml"


class Prompt:
    """MicroPython's prompt on the serial port of a virtual micro:bit."""

    def __init__(self, bench: VirtualBench) -> None:
        self.bench, self.board = bench, bench.machine
        self.board.run_until(0.6)
        self.greeting = self.board.uart0.host_read(1000).lstrip(b"\0").decode()

    def ask(self, line: str, wait_s: float = 0.2) -> str:
        """Type a line, and return the answer without the echo and the next prompt."""
        self.board.uart0.host_write(line.encode() + b"\r")
        self.board.run_until(self.board.time_s + wait_s)
        echo, *answer, prompt = self.board.uart0.host_read(1 << 16).decode().split("\r\n")
        assert (echo, prompt) == (line, ">>> ")
        return "\n".join(answer)


@pytest.fixture(scope="module")
def booted(micropython_hex: Path) -> VirtualBench:
    return VirtualBench(load_rig(RIG), firmware=micropython_hex)


@pytest.fixture
def prompt(booted: VirtualBench) -> Iterator[Prompt]:
    before = booted.snapshot()
    yield Prompt(booted)
    booted.restore(before)


def test_micropython_greets_and_computes(prompt: Prompt) -> None:
    assert prompt.greeting == (
        "MicroPython v1.9.2-34-gd64154c73 on 2017-09-01; micro:bit v1.0.1 with nRF51822\r\n"
        'Type "help()" for more information.\r\n>>> '
    )
    assert prompt.ask("import microbit") == ""
    assert prompt.ask("2**40 // 3") == "366503875925"
    assert prompt.ask("microbit.temperature()") == "25"
    assert prompt.board.unmodelled == ()


def test_gravity_and_field_have_the_board_s_axes(prompt: Prompt) -> None:
    """Level: z = -1024; the right edge down: x > 0; the edge with the contacts up: y < 0 (MicroPython's manual)."""
    expected = {Pose(0.0): (0, 0, -1024), Pose(0.0, 0.0, 30.0): (512, 0, -887), Pose(0.0, -30.0, 0.0): (0, -512, -887)}
    for pose, values in expected.items():
        prompt.bench.turn_to(pose)
        # The part has offsets of up to 20 mg, and the firmware takes the high byte of its words alone: 16 mg.
        assert literal_eval(prompt.ask("accelerometer.get_values()")) == pytest.approx(values, abs=36)
    assert prompt.ask("compass.is_calibrated()") == "False"


def test_the_display_shows_letters_and_the_buttons_are_read(prompt: Prompt) -> None:
    prompt.ask('display.show("A")')
    assert prompt.board.display_rows() == (".##..", "#..#.", "####.", "#..#.", "#..#.")
    assert prompt.ask("button_a.is_pressed()") == "False"
    prompt.board.press("button A")
    prompt.board.run_until(prompt.board.time_s + 0.1)
    assert prompt.ask("button_a.is_pressed(), button_b.is_pressed()") == "(True, False)"


def test_a_file_is_stored_in_flash_and_still_there_after_a_reset(prompt: Prompt) -> None:
    prompt.ask('f = open("a.txt", "w"); n = f.write("hello"); f.close()', 0.5)
    prompt.board.reset()
    prompt.board.run_until(prompt.board.time_s + 0.5)
    prompt.board.uart0.host_read(1000)
    assert prompt.ask('open("a.txt").read()') == "'hello'"


def test_time_passes_as_the_board_s_clock_says(prompt: Prompt) -> None:
    before_s, before_ms = prompt.board.time_s, int(prompt.ask("running_time()"))
    prompt.board.run_until(before_s + 5.0)
    after_s, after_ms = prompt.board.time_s, int(prompt.ask("running_time()"))
    # The firmware loses the time between two instructions, which read and restart its timer, at each tick of 6 ms.
    assert after_ms - before_ms == pytest.approx(1000 * (after_s - before_s), abs=10)


def test_a_board_repeats_its_actions_from_a_snapshot(prompt: Prompt) -> None:
    def work() -> tuple[str, int, int, tuple[str, ...]]:
        prompt.bench.begin_turn(Pose(40.0, 10.0, -5.0))
        answers = [prompt.ask(line) for line in ("compass.get_x()", "accelerometer.get_values()", "display.show('B')")]
        core = prompt.board.processor.core
        return "\n".join(answers), core.cycles, core.instructions, prompt.board.display_rows()

    before = prompt.bench.snapshot()
    once = work()
    prompt.bench.restore(before)
    assert work() == once
