"""The fixture ``cycles``: a function of any ELF under a limit, in one line, in any project."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

# As in conftest.py: numpy and what is built on it cannot be imported twice in one process.
import hiltest.virtual.profiling.image  # noqa: F401
from hiltest.boards import default_firmware
from hiltest.text import format_number
from hiltest.virtual.board.k64f import VirtualK64F

PROGRAMS = Path(__file__).parents[1] / "virtual" / "programs"
SUM = (
    "int sum(int n) {{ int s = 0; for (int i = 0; i < n; i++) s += i * i {more}; return s; }}\n"
    "int main(void) {{ return sum(3); }}\n"
)
TEST = """
from hiltest.measurement import Limit

def test_sum(cycles, measure):
    measure("cycles.sum", cycles("app.elf").call("sum", 20), limit=Limit(max={most}))
"""


@pytest.fixture(autouse=True)
def _no_rig(monkeypatch: pytest.MonkeyPatch, _no_settings_from_outside: None) -> None:
    monkeypatch.delenv("HIL_RIG")


@pytest.fixture
def compile_app(pytester: pytest.Pytester, require_tool: Callable[[str], str]) -> Callable[[str], int]:
    """Return a function that builds app.elf and says what sum(20) costs."""
    compiler = require_tool("arm-none-eabi-gcc")

    def compile_it(more: str) -> int:
        source, elf = pytester.path / "app.c", pytester.path / "app.elf"
        source.write_text(SUM.format(more=more))
        subprocess.run(
            [
                compiler,
                "-mcpu=cortex-m4",
                "-mthumb",
                "-mfpu=fpv4-sp-d16",
                "-mfloat-abi=hard",
                "-O1",
                "-g",
                "-nostdlib",
                "-ffreestanding",
                f"-Wl,-T,{PROGRAMS / 'flash.ld'}",
                str(PROGRAMS / "start.S"),
                str(source),
                "-o",
                str(elf),
            ],
            check=True,
            timeout=60,
        )
        return VirtualK64F(elf).call("sum", 20).cycles

    return compile_it


def record_of(pytester: pytest.Pytester) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    return content


def test_a_function_gets_a_limit_in_one_line_and_turns_red_when_it_gets_slower(
    pytester: pytest.Pytester, compile_app: Callable[[str], int]
) -> None:
    before = compile_app("")
    pytester.makepyfile(TEST.format(most=before))
    result = pytester.runpytest_inprocess()
    result.assert_outcomes(passed=1)
    assert result.ret == 0
    record = record_of(pytester)
    (measured,) = record["measurements"]
    assert (record["rig"], record["board"], record["verdict"]["complete"]) == (None, None, True)
    assert {key: measured[key] for key in ("value", "unit", "cycle_model", "outcome")} == {
        "value": before,
        "unit": "cycle",
        "cycle_model": "cortex-m4-trm/3@flash",
        "outcome": "pass",
    }

    after = compile_app("+ n / (i + 1)")
    assert after > before
    result = pytester.runpytest_inprocess()
    assert result.ret == 1
    result.stdout.fnmatch_lines([f"  cycles.sum {format_number(after)} cycles (limit {format_number(before)}),*"])


def test_a_function_is_called_at_the_core_clock_of_its_part(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        import pytest
        from hiltest.errors import ConfigError

        def test_clock(cycles):
            usual = cycles().call("crc32", b"123456789", 9)
            slower = cycles(clock_hz=48_000_000).call("crc32", b"123456789", 9)
            assert slower.cycles == usual.cycles
            assert slower.microseconds == pytest.approx(2.5 * usual.microseconds, rel=1e-12)  # float64
            for wrong in (0, -1, 48, 2e9, 48e6 + 0.5, float("nan")):
                with pytest.raises(ConfigError, match="from 1 kHz to 1 GHz"):
                    cycles(clock_hz=wrong)
    """)
    pytester.runpytest_inprocess().assert_outcomes(passed=1)


def test_the_firmware_under_test_needs_no_name_and_code_in_sram_says_so(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        def test_default(cycles, measure):
            found = cycles().call("magnetometer_empty", 0, 0)
            assert measure("cycles.empty", found).cycle_model == "cortex-m4-trm/3@sram"
            assert found.functions[0].name == "magnetometer_empty"
    """)
    pytester.runpytest_inprocess(f"--hil-firmware={default_firmware()}").assert_outcomes(passed=1)
    pytester.runpytest_inprocess().assert_outcomes(passed=1)
    assert record_of(pytester)["measurements"][0]["value"] == 3


def test_an_elf_is_found_from_wherever_pytest_is_started(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    (pytester.path / "build").mkdir()
    (pytester.path / "build" / "app.elf").write_bytes(default_firmware().read_bytes())
    pytester.makeini("[pytest]\n")
    pytester.makepyfile("""
        def test_it(cycles):
            assert cycles("build/app.elf").call("crc32", b"123456789", 9).value == 0xCBF43926
    """)
    monkeypatch.chdir(pytester.mkdir("elsewhere"))
    pytester.runpytest_inprocess("..").assert_outcomes(passed=1)
    assert not (pytester.path / "hil-out").exists(), "nothing measured, nothing recorded"


def test_what_is_wrong_is_said_in_the_test(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        def test_no_elf(cycles):
            cycles("gone.elf")

        def test_no_function(cycles):
            cycles().call("crc3")

        def test_unit(cycles, measure):
            measure("x", cycles().call("magnetometer_empty", 0, 0), "us")
    """)
    result = pytester.runpytest_inprocess()
    result.assert_outcomes(failed=3)
    result.stdout.fnmatch_lines(
        [
            "*gone.elf: No such file or directory; name the firmware's ELF*",
            "*no function 'crc3'; near: crc32",
            "*ValueError: x: a counted call has its unit and its cycle model: leave both out",
        ]
    )


def test_a_limit_of_the_rig_holds_where_a_rig_is_named(pytester: pytest.Pytester, default_rig: str) -> None:
    text = default_rig[: default_rig.index("[limits]")]
    (pytester.path / "mine.toml").write_text(text + '[limits]\n"cycles.direct.total" = { max = 2, unit = "cycle" }\n')
    pytester.makepyfile("""
        def test_it(cycles, measure):
            measure("cycles.direct.total", cycles().call("magnetometer_empty", 0, 0))
    """)
    result = pytester.runpytest_inprocess("--hil-rig=mine.toml")
    assert result.ret == 1
    result.stdout.fnmatch_lines(["  cycles.direct.total 3 cycles (limit 2),*"])
    assert record_of(pytester)["rig"]["name"]


def test_a_missing_value_under_a_limit_fails_closed_without_a_rig_too(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        from hiltest.measurement import Limit

        def test_it(measure):
            measure("x", None, "deg", limit=Limit(max=2))
    """)
    assert pytester.runpytest_inprocess().ret == 22
