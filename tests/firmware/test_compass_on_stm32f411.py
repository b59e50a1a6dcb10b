"""The sample compass on the STM32F411 Discovery: its gyroscope, the calibration in flash, and parts that fail."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltest.boards.bench import VirtualBench
from hiltest.rig.rig_file import load_rig

pytestmark = pytest.mark.slow

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "stm32f411-disco.toml"


class Disco:
    """The board on its bench, from power-on."""

    def __init__(self, rig: Path = RIG) -> None:
        self.bench = VirtualBench(load_rig(rig))
        self.bench.power_on()
        self._rest = ""

    def lines(self, seconds: float) -> list[str]:
        """The lines that are complete after a time."""
        self.bench.machine.run_until(self.bench.time_s + seconds)
        uart = self.bench.machine.uart0
        text = self._rest + uart.host_read(uart.host_waiting).decode()
        *complete, self._rest = text.split("\r\n")
        return complete

    def reset(self) -> None:
        self._rest = ""  # a reset cuts a line off
        self.bench.machine.reset()

    def type(self, text: str) -> None:
        self.bench.machine.uart0.host_write(text.encode())


def changed_rig(folder: Path, old: str, new: str) -> Path:
    text = RIG.read_text(encoding="utf-8")
    assert text.count(old) == 1
    changed = folder / RIG.name
    changed.write_text(text.replace(old, new), encoding="utf-8")
    return changed


def groups(line: str) -> dict[str, str]:
    return dict(group.split("=", 1) for group in line.split(" "))


@pytest.fixture(scope="module")
def calibrated() -> Disco:
    """The compass after a tumble."""
    disco = Disco()
    disco.lines(disco.bench.tumble(20.0) + 0.2)
    return disco


def test_the_gyroscope_s_rate_is_printed_along_the_axes_of_the_board() -> None:
    disco = Disco()
    bias_dps = disco.bench.rig.world.gyroscope_bias_dps
    disco.lines(0.2)
    at_rest = [np.array(groups(line)["GYR"].split(","), float) for line in disco.lines(2.0)]
    # 0.106 dps of noise in each of 25 readings: 5 sigma of their mean.
    np.testing.assert_allclose(np.mean(at_rest, axis=0), bias_dps, atol=0.11)
    disco.bench.turn_round(120.0, rate_dps=30.0, after_s=0.1)
    disco.lines(1.0)
    turning = [np.array(groups(line)["GYR"].split(","), float) for line in disco.lines(2.0)]
    np.testing.assert_allclose(np.mean(turning, axis=0), np.add(bias_dps, [0.0, 0.0, 30.0]), atol=0.11)


def test_a_calibration_is_saved_on_request_and_loaded_after_a_reset(calibrated: Disco) -> None:
    (before,) = [line for line in calibrated.lines(0.1) if line.startswith("CAL=")][-1:]
    assert groups(before)["CAL"] == "1"
    calibrated.type("SAVE\r\n")
    answers = calibrated.lines(4.0)
    assert "SAVED" in answers
    calibrated.reset()
    fit, first, *_ = calibrated.lines(1.0)
    assert fit.startswith("CALIBRATED points=1 hard=")  # of this start; the fit is of the points before
    assert groups(first)["CAL"] == "1"
    hard_iron_ut = [float(value) for value in groups(fit.removeprefix("CALIBRATED "))["hard"].split(",")]
    np.testing.assert_allclose(hard_iron_ut, (2.4, -2.2, 4.0), atol=0.3)


def test_nothing_is_saved_before_a_calibration_and_by_another_line() -> None:
    disco = Disco()
    disco.type("SAVE\r")
    assert [line for line in disco.lines(0.3) if line.startswith("ERROR")] == ["ERROR SAVE: not calibrated yet"]
    disco.type("save\rSAVED\rSAVE AGAIN, WITH MORE LETTERS THAN A LINE HAS\r")
    assert all(line.startswith("CAL=0 ") for line in disco.lines(1.0))
    disco.reset()
    assert all(line.startswith("CAL=0 ") for line in disco.lines(1.0))


def test_without_its_gyroscope_it_says_so_and_goes_on(tmp_path: Path) -> None:
    part = """
[[sensors.parts]]
part = "i3g4250d"
bus = "spi1"
chip_select = "PE3"
axes = ["x", "-y", "-z"]
"""
    rig = changed_rig(tmp_path, part, "")
    rig.write_text(rig.read_text(encoding="utf-8").replace('gyroscope = "I3G4250D"\n', ""), encoding="utf-8")
    lines = Disco(rig).lines(1.0)
    assert lines[0] == "ERROR I3G4250D"
    assert len(lines) > 8
    assert all("ACC=" in line and "GYR=" not in line for line in lines[1:])


def test_a_sensor_that_falls_silent_is_set_up_again(tmp_path: Path) -> None:
    absent = '\n[faults]\nsensor = { part = "lsm303agr", fault = "absent", after_s = 0.5, for_s = 0.5 }\n\n[limits]\n'
    lines = Disco(changed_rig(tmp_path, "\n[limits]\n", absent)).lines(4.0)
    errors = [index for index, line in enumerate(lines) if line.startswith("ERROR")]
    assert lines[errors[0]] == "ERROR a sensor fell silent"
    assert errors[0] > 0
    assert len(lines) - errors[-1] > 20  # of 12.5 a second
    assert all(line.startswith("CAL=0 HDG=") for line in lines[errors[-1] + 1 :])


def test_a_bus_that_was_held_is_used_again(tmp_path: Path) -> None:
    held = '\n[faults]\nheld_line = { bus = 1, line = "sda", after_s = 0.5, for_s = 0.3 }\n\n[limits]\n'
    lines = Disco(changed_rig(tmp_path, "\n[limits]\n", held)).lines(4.0)
    errors = [index for index, line in enumerate(lines) if line.startswith("ERROR")]
    assert "ERROR a sensor fell silent" in lines
    assert len(lines) - errors[-1] > 20
