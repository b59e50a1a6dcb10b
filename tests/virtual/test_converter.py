"""ADC16: numbers of voltages, the time that they take, and which of them are let through."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hiltest.boards.bench import VirtualBench
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build, follow, word

RIG = Path(__file__).parents[2] / "hil/rigs/virtual-k64f.toml"
BUS_HZ = 640 * 32_768  # out of reset
HEAD = """
#define ADC(offset) WORD(0x4003B000 + (offset))
enum { SC1A, CFG1 = 8, CFG2 = 12, RA = 16, CV1 = 24, CV2 = 28, SC2 = 32, SC3 = 36, PG = 44 };
volatile unsigned fired, value, began, took, status;
void Interrupt39_Handler(void) { fired++; value = ADC(RA); }
static void begin(void) {
    WORD(0x4004803C) |= 1u << 27; WORD(0xE000E104) = 1u << 7;
    WORD(0xE000EDFC) = 1u << 24; WORD(0xE0001000) = 1; /* CYCCNT */
}
static unsigned convert(unsigned channel) {
    began = WORD(0xE0001004);
    ADC(SC1A) = channel;
    while (!(ADC(SC1A) & 0x80)) {}
    took = WORD(0xE0001004) - began;
    return ADC(RA);
}
"""


def board_of(build_c: Build, body: str) -> VirtualK64F:
    return VirtualK64F(build_c(f"{HEAD}int main(void) {{ begin(); (void)convert; {body} return 0; }}"))


@pytest.mark.parametrize(
    ("config", "volts", "expected"),
    [
        (0x00, 1.2, 93),
        (0x08, 1.2, 372),
        (0x04, 1.2, 1489),
        (0x0C, 1.2, 23_831),
        (0x04, 3.3, 4095),
        (0x04, 9.0, 4095),
        (0x04, -1.0, 0),
        (0x04, 0.0004, 0),
        (0x04, 0.00041, 1),
    ],
)
def test_a_voltage_becomes_a_number_of_so_many_bits(build_c: Build, config: int, volts: float, expected: int) -> None:
    board = board_of(build_c, f"ADC(CFG1) = {config}; value = convert(12);")
    board.adc_volts[0, 12] = volts
    board.adc_volts[1, 12] = 2.0  # of the other converter
    follow(board, {0.001: {"value": expected}})


def test_a_differential_number_has_a_sign(build_c: Build) -> None:
    board = board_of(build_c, "ADC(CFG1) = 4; value = convert(0x20);")
    board.adc_volts[0, 0] = -1.65
    follow(board, {0.001: {"value": 0xF800}})


@pytest.mark.parametrize(
    ("channel", "expected"),
    [(26, 0.716 / 3.3 * 65536), (27, 65536 / 3.3), (29, 65535), (30, 0)],
    ids=["temperature", "bandgap", "VREFH", "VREFL"],
)
def test_the_chip_has_voltages_of_its_own(build_c: Build, channel: int, expected: float) -> None:
    board = board_of(build_c, f"ADC(CFG1) = 0xC; value = convert({channel});")
    board.run_until(0.001)
    assert word(board, "value") == pytest.approx(expected, abs=1)


def test_the_temperature_sensor_feels_the_world(build_c: Build, tmp_path: Path) -> None:
    path = build_c(HEAD + "int main(void) { begin(); ADC(CFG1) = 0xC; value = convert(26); return 0; }")
    rig = tmp_path / "warm.toml"
    rig.write_text(re.sub(r"temperature_degc = .*\n.*\n.*", "temperature_degc = 85.0", RIG.read_text()))
    bench = VirtualBench(load_rig(rig), firmware=path)
    bench.machine.run_until(0.001)
    assert word(bench.machine, "value") == pytest.approx((0.716 - 60 * 0.00162) / 3.3 * 65536, abs=1)


@pytest.mark.parametrize(
    ("set_up", "seconds"),
    [
        ("ADC(CFG1) = 0;", (5 + 17 + 5) / BUS_HZ),
        ("ADC(CFG1) = 0xC;", (5 + 25 + 5) / BUS_HZ),
        ("ADC(CFG1) = 0x64;", ((5 + 20) * 8 + 5) / BUS_HZ),
        ("ADC(CFG1) = 0x14;", (3 + 20 + 20 + 5) / BUS_HZ),
        ("ADC(CFG1) = 0x14; ADC(CFG2) = 7;", (3 + 20 + 2 + 2 + 5) / BUS_HZ),
        ("ADC(CFG1) = 4; ADC(SC3) = 7;", (5 + 32 * 20 + 5) / BUS_HZ),
        ("ADC(CFG1) = 0x66;", 25 * 8 / 50e6 + 5 / BUS_HZ),
        ("ADC(CFG1) = 0x65;", 25 * 8 / 48e6 + 5 / BUS_HZ),
        ("ADC(CFG1) = 0x67; ADC(CFG2) = 8;", 25 * 8 / 5.2e6 + 5 / BUS_HZ),
        ("ADC(CFG1) = 0xE7; ADC(CFG2) = 8;", 25 * 8 / 2.4e6 + 5 / BUS_HZ),
        ("ADC(CFG1) = 0x67;", 5e-6 + 25 * 8 / 5.2e6 + 5 / BUS_HZ),
    ],
)
def test_a_conversion_takes_its_time(build_c: Build, set_up: str, seconds: float) -> None:
    board = board_of(build_c, f"{set_up} value = convert(12);")
    board.run_until(0.001)
    # The loop that waits has some ten cycles a turn, one of them begun too late.
    assert 0 <= word(board, "took") - seconds * BUS_HZ < 25


def test_it_interrupts_and_goes_on_until_it_is_told_otherwise(build_c: Build) -> None:
    divides = "for (;;) { status = status * 1664525u + 1013904223u; took = ~0u / (status >> (status >> 27)); }"
    board = board_of(build_c, f"ADC(CFG1) = 0x64; ADC(SC3) = 8; ADC(SC1A) = 0x40 | 12; {divides}")
    board.adc_volts[0, 12] = 1.2
    board.run_until(0.001)
    before = word(board, "fired")
    board.adc_volts[0, 12] = 2.4
    board.run_until(0.051)
    assert word(board, "fired") - before == pytest.approx(0.05 * BUS_HZ / 160, abs=1), "none waits for the core"
    assert word(board, "value") == 2979


@pytest.mark.parametrize(
    ("control", "limits", "passing"),
    [
        (0x20, (1000, 0), [500]),
        (0x30, (1000, 0), [1000, 1500, 2500]),
        (0x28, (1000, 2000), [500, 2500]),
        (0x38, (1000, 2000), [1000, 1500]),
        (0x28, (2000, 1000), [1500]),
        (0x38, (2000, 1000), [500, 1000, 2500]),
    ],
    ids=["less", "not less", "outside", "inside", "inside, limits not", "outside, limits too"],
)
def test_only_what_compares_is_shown(build_c: Build, control: int, limits: tuple[int, int], passing: list[int]) -> None:
    body = f"ADC(CFG1) = 4; ADC(SC2) = {control}; ADC(CV1) = {limits[0]}; ADC(CV2) = {limits[1]}; ADC(SC1A) = 0x4C;"
    elf = build_c(f"{HEAD}int main(void) {{ begin(); (void)convert; {body} return 0; }}")
    results = []
    for number in (500, 1000, 1500, 2500):
        board = VirtualK64F(elf)
        board.adc_volts[0, 12] = number * 3.3 / 4096
        board.run_until(0.0005)
        if word(board, "fired"):
            results.append(word(board, "value"))
    assert results == passing


@pytest.mark.parametrize(
    ("body", "expected"),
    [("", 0x00), ("ADC(PG) = 1;", 0x40)],
    ids=["left alone", "written to"],
)
def test_a_calibration_takes_its_time_and_fails_when_it_is_disturbed(build_c: Build, body: str, expected: int) -> None:
    calibrate = f"began = WORD(0xE0001004); ADC(SC3) = 0x87; value = ADC(SC3); {body}"
    wait = "while (!(ADC(SC1A) & 0x80) && !(ADC(SC3) & 0x40)) {} took = WORD(0xE0001004) - began; status = ADC(SC3);"
    board = board_of(build_c, f"ADC(CFG1) = 0; {calibrate} {wait}")
    board.run_until(0.002)
    assert word(board, "value") & 0x80
    assert word(board, "status") & 0xC0 == expected
    assert word(board, "took") == pytest.approx(14_100 if not expected else 0, abs=60)


def test_a_hardware_trigger_is_named(build_c: Build) -> None:
    board = board_of(build_c, "ADC(SC2) = 0x40; ADC(SC1A) = 12;")
    board.run_until(0.001)
    assert [access.register for access in board.unmodelled] == ["ADC0_SC2"]
