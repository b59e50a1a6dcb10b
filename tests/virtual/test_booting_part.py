"""Firmware that asks a part before it has booted is told the reason, and a reset later is as on a bench."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.command_files import run

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.world import EarthField, World
from hiltest.world.sensors.fxas21002c import Fxas21002c

from .conftest import Build, word

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "text-compass.toml"
# As NXP's examples for the FXAS21002C: the part is asked once for its identity, 6.9 ms after power-on.
ASKS = """
unsigned answered;
int main(void) {
  for (volatile int i = 0; i < %d; i++) { }
  WORD(0x40048034) |= 3u << 6;
  WORD(0x40048038) |= 0x3E00;
  BYTE(%s + 1) = 0x14;
  BYTE(%s + 2) = 0x80;
  BYTE(%s + 2) = 0xB0;
  BYTE(%s + 4) = 0x40;
  while (!(BYTE(%s + 3) & 2)) { }
  answered = 1 + (BYTE(%s + 3) & 1);
  BYTE(%s + 2) = 0x80;
  for (;;) { }
}
"""


def asks(loops: int, bus: int) -> str:
    return ASKS % (loops, *[f"0x{0x40066000 + 0x1000 * bus:x}"] * 7)


ANSWERS, SILENT = 1, 2


def test_a_part_that_still_boots_is_named_and_answers_after_a_reset(build_c: Build) -> None:
    board = VirtualK64F(build_c(asks(14_000, 0)), i2c0=[Fxas21002c(World(EarthField(48.5, 62.0, 3.5)), seed=1)])
    board.run_until(0.08)
    assert word(board, "answered") == SILENT
    sentence = board.unanswered_part()
    assert sentence.startswith("the FXAS21002C on I2C0 was still booting when the firmware asked it, ")
    assert 5.0 < float(sentence.partition("asked it, ")[2].split()[0]) < 9.0
    board.reset()
    board.run_until(0.16)
    assert (word(board, "answered"), board.unanswered_part()) == (ANSWERS, "")


def test_a_part_that_is_asked_late_enough_is_no_remark(build_c: Build) -> None:
    board = VirtualK64F(build_c(asks(140_000, 0)), i2c0=[Fxas21002c(World(EarthField(48.5, 62.0, 3.5)), seed=1)])
    board.run_until(0.2)
    assert (word(board, "answered"), board.unanswered_part()) == (ANSWERS, "")


@pytest.mark.slow
def test_serve_and_listen_say_so_at_their_end(build_c: Build, capsys: pytest.CaptureFixture[str]) -> None:
    elf = build_c(asks(14_000, 1))
    assert run("serve", "--rig", str(RIG), "--firmware", str(elf), "--until", "0.3", "--no-wait") == 0
    assert "board: the FXAS21002C on I2C1 was still booting" in capsys.readouterr().err
    assert run("listen", "--rig", str(RIG), "--firmware", str(elf), "--seconds", "0.3") == 1
    assert "the FXAS21002C on I2C1 was still booting" in capsys.readouterr().err
