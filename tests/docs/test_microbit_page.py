"""The page about the micro:bit: its program prints the letter, and its commands name the rig and its package."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from hiltest.virtual.part.chip import chip

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "microbit.md").read_text(encoding="utf-8")


def test_the_program_shows_the_letter(micropython_hex: Path) -> None:
    (program,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
    program = program.replace("usr/share/firmware-microbit-micropython/firmware.hex", str(micropython_hex))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=120)
    assert done.stdout.splitlines() == [".##..", "#..#.", "####.", "#..#.", "#..#."], done.stderr


def test_every_block_of_the_chip_is_in_the_table() -> None:
    section = PAGE.partition("## What is modelled")[2]
    aliases = {"SPI1": "TWI1", "CLOCK": "CLOCK", "ROM": "FICR", "SWI": "GPIOTE"}  # SWI has no registers
    for module in chip("nrf51822").peripherals:
        name = aliases.get(module.name, module.name)
        stem, number = re.fullmatch(r"(.*?)(\d?)", name).groups()  # type: ignore[union-attr]
        assert name in section or (number and f"{stem}0 to {stem}2" in section), module.name


@pytest.mark.parametrize("command", re.findall(r"^hiltest run (.*)$", PAGE, re.M))
def test_the_command_names_a_rig_that_ships_and_the_package_s_file(command: str) -> None:
    rig, file = re.fullmatch(r"--rig (\S+) --firmware (\S+)", command).groups()  # type: ignore[union-attr]
    assert (ROOT / "hil" / "rigs" / f"{rig}.toml").is_file()
    assert file == "usr/share/firmware-microbit-micropython/firmware.hex"
