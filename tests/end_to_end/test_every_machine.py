"""Commands of hiltest on every machine: profile, judge, serve with GDB, coverage, stack and cycles."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.command_files import run
from tests.serve.conftest import Served

from hiltest.boards.bench import VirtualBench
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.coverage.source_map import SourceMap

PROGRAM = """
extern int stack_top;
volatile int total;
__attribute__((noipa)) int weighed(int n)
{
    int sum = 0;
    for (int i = 0; i < n; i++)
        sum += i * n;
    return sum;
}
void start(void)
{
    for (;;)
        total = weighed(20);
}
__attribute__((section(".vectors"), used)) const void *vectors[64] = {&stack_top, start};
"""
LINK = """
MEMORY {{ flash (rx) : ORIGIN = {flash}, LENGTH = 16K  ram (rwx) : ORIGIN = {ram}, LENGTH = 8K }}
SECTIONS {{ .text : {{ KEEP(*(.vectors)) *(.text*) }} > flash  .bss : {{ *(.bss*) }} > ram  stack_top = {ram} + 8K; }}
"""
RIG = """
schema = 1
name = "machine"
[board]
kind = "virtual"
machine = "{machine}"
firmware = "app.elf"
[device]
kind = "text"
[device.text]
patterns = ['HDG=(?P<heading>\\S+)']
[field]
strength_ut = 48.5
dip_deg = 62.0
declination_deg = 3.5
[turntable]
kind = "simulated"
uncertainty_deg = 0.1
[sensors]
magnetometer = "LSM303AGR magnetometer"
accelerometer = "LSM303AGR accelerometer"
magnetometer_noise_ut = 0.3
[[sensors.parts]]
part = "lsm303agr"
bus = "{bus}"
[procedure]
headings_deg = [0, 90, 180, 270]
tilts_deg = [[0, 0]]
poses = "all"
[world]
fitted = []
soft_iron = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
hard_iron_ut = [0, 0, 0]
temperature_degc = 25.0
"""
LOOP_LINE = 1 + PROGRAM.splitlines().index("        sum += i * n;")
VALUE = sum(20 * i for i in range(20))


@dataclass(frozen=True, slots=True)
class Expected:
    """A machine: build options, begin of flash and RAM, options of profile, cycle model, core for GDB, and CPUID."""

    machine: str
    cpu: str
    flash: int
    ram: int
    part: tuple[str, ...]
    model: str
    core: str
    identity: str


MACHINES = [
    Expected(
        "frdm-k64f", "cortex-m4", 0, 0x20000000, ("--part", "mk64f12"), "mk64f12/1", "Cortex-M4F", "0x410fc241"
    ),
    Expected("microbit-v1", "cortex-m0", 0, 0x20000000, (), "generic-m0/1", "Cortex-M0", "0x410cc200"),
    Expected(
        "stm32f411-disco",
        "cortex-m4",
        0x08000000,
        0x20000000,
        ("--part", "stm32f411"),
        "stm32f411/1-3ws",
        "Cortex-M4F",
        "0x410fc241",
    ),
    Expected(
        "mine.toml", "cortex-m4", 0x08000000, 0x20000000, ("--part", "stm32f407"), "stm32f407/1-5ws", "Cortex-M4F",
        "0x410fc241",
    ),
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Built:
    """A program for a machine, and its rig."""

    expected: Expected
    elf: Path
    rig: Path


@pytest.fixture(params=MACHINES, ids=lambda expected: expected.machine)
def built(request: pytest.FixtureRequest, tmp_path: Path, require_tool: Callable[[str], str]) -> Built:
    """A machine with its program; the last one is a file of the user, in the folder of the rig."""
    expected: Expected = request.param
    elf, rig = tmp_path / "app.elf", tmp_path / "rig.toml"
    (tmp_path / "app.c").write_text(PROGRAM)
    (tmp_path / "app.ld").write_text(LINK.format(flash=expected.flash, ram=expected.ram))
    (tmp_path / "mine.toml").write_text('like = "stm32f407-disco"\ntitle = "mine"\n')
    options = [f"-mcpu={expected.cpu}", "-mthumb", "-O1", "-g", "-nostdlib", "-ffreestanding", "-Wl,--build-id=none"]
    compiler = require_tool("arm-none-eabi-gcc")
    subprocess.run([compiler, *options, "-T", "app.ld", "app.c", "-o", elf], cwd=tmp_path, check=True, timeout=60)
    rig.write_text(RIG.format(machine=expected.machine, bus="i2c0" if expected.machine == "microbit-v1" else "i2c1"))
    return Built(expected, elf, rig)


def test_a_function_is_profiled_by_the_prices_of_the_machine_s_part(
    built: Built, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("profile", *built.expected.part, "--json", str(built.elf), "weighed", "20") == 0
    profile = json.loads(capsys.readouterr().out)
    assert profile["returned"] == VALUE
    assert profile["cycle_model"].startswith(built.expected.model)


def test_running_firmware_is_covered_and_its_calls_and_its_stack_are_counted(built: Built) -> None:
    bench = VirtualBench(load_rig(built.rig), firmware=built.elf, watches_execution=True)
    watch = bench.machine.watch_calls(["weighed"])
    bench.machine.run_until(0.001)
    calls = watch.calls("weighed")
    assert len(calls) > 5
    assert len({call.cycles for call in calls[2:]}) == 1  # the first ones fill caches
    assert bench.machine.stack_bounds(["weighed"])["weighed"] == 0
    assert bench.execution is not None
    (file,) = SourceMap(bench.machine.image).coverage(bench.execution.code()).files.values()
    begun = file.functions["weighed"][1]
    assert begun in (len(calls), len(calls) + 1)
    assert file.lines[LOOP_LINE] in range(20 * len(calls), 20 * begun + 1)


@pytest.fixture
def served(built: Built) -> Iterator[Served]:
    """`hiltest serve` with the machine, in the folder of its rig."""
    process = Served("--rig", str(built.rig), "--gdb", "0", folder=built.rig.parent)
    yield process
    process.kill()


def test_debians_gdb_stops_at_a_function_and_reads_registers_of_the_core(
    built: Built, served: Served, require_tool: Callable[[str], str]
) -> None:
    commands = [
        f"target remote 127.0.0.1:{served.gdb_port}",
        "break weighed",
        "continue",
        "print n",
        "finish",
        "info threads",
        "print/x *(unsigned *)0xE000ED00",
        "print/x *(unsigned *)0",
        "detach",
    ]
    arguments = [item for command in commands for item in ("-ex", command)]
    gdb = [require_tool("gdb-multiarch"), "-nx", "-batch", *arguments, str(built.elf)]
    output = subprocess.run(gdb, capture_output=True, text=True, timeout=60, check=True).stdout
    for line in (
        "Breakpoint 1, weighed (n=n@entry=20)",
        "$1 = 20",
        f"Value returned is $2 = {VALUE}",
        f"Thread 1 ({built.expected.core})",
        f"$3 = {built.expected.identity}",
        f"$4 = {built.expected.ram + 0x2000:#x}",
    ):
        assert line in output, output


@pytest.mark.ci
@pytest.mark.parametrize(("part", "cycles"), [("stm32f411", 4884), ("generic-m0", 47_397), ("generic-m33", 3974)])
def test_a_source_is_compiled_and_judged_for_the_part(
    part: str, cycles: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, require_tool: Callable[[str], str]
) -> None:
    require_tool("arm-none-eabi-gcc")
    require_tool("cc")
    monkeypatch.chdir(tmp_path)
    assert run("judge", "--init", "first.c") == 0
    assert run("judge", "first.c", "--part", part, "--alone", "--out", "out") == 0
    (entry,) = json.loads((tmp_path / "out" / "judge.json").read_text(encoding="utf-8"))["entries"]
    assert entry["cost"]["cycles"] == cycles  # as exact as every count of the virtual core
