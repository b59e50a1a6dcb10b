"""Every command has --json, and prints one document, which its JSON Schema describes."""

from __future__ import annotations

import importlib.util
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pytest
from tests.command_files import checked, folder_of_all_inputs, run
from tests.finished_run import Finished

from hiltest.commands.cli import every_command
from hiltest.rig.bench_files import shipped

DOCS = Path(__file__).parents[1] / "docs"
# What makes each command print its document, and its exit code where that is not 0.
PRINTING = {
    "fit noise": ("fit", "noise", "rates.csv"),
    "baseline save": ("baseline", "save", "run.json", "saved.json"),
    "baseline update": (
        "baseline",
        "update",
        "--accept",
        "cycles.direct.total",
        "--because",
        "a test",
        "base.json",
        "dearer.json",
    ),
    "baseline review": ("baseline", "review", "base.json", "base.json"),
    "calibrate": ("calibrate",),
    "compare": ("compare", "base.json", "run.json", "--detect", "0.05deg"),
    "decode": ("decode", "packets.bin"),
    "listen": ("listen", "--rig", "text-compass", "--seconds", "1"),
    "doctor": ("doctor", "--rig", "virtual-k64f"),
    "explain": ("explain", "dearer.json", "--baseline", "base.json"),
    "report export": ("report", "export", "run.json", "--format", "bencher"),
    "fit": ("fit", "points.csv", "--on", "host"),
    "fit imu": ("fit", "imu", "imu.csv"),
    "init": ("init", "bench"),
    "log": ("log", "--seconds", "1", "--out", "log.csv"),
    "play": ("play", "--rig", "field.toml"),
    "ports": ("ports",),
    "profile": ("profile", "shipped", "crc32", "text:123456789", "9"),
    "judge": ("judge", "mine.py:calibrate", "--alone"),
    "report": ("report", "run.json"),
    "serve": ("serve", "--no-wait", "--until", "1"),
    "study": ("study", "imu", "--instances", "1", "--jobs", "1"),
    "timing measure": ("timing", "measure"),
    "timing show": ("timing", "show"),
    "report trend": ("report", "trend", "."),
    "profile worst": ("profile", "worst", "direct", "--calls", "20"),
}
# A run or a board of their own: in tests/campaigns/test_bisect.py, tests/flashing/test_flash_command.py,
# tests/boards/test_contributed_profile.py, tests/test_mcp_command.py, tests/test_start_command.py, and below.
ELSEWHERE = {"bisect", "flash", "mcp", "run", "start", "timing check"}


def schemas_of(command: click.Command) -> list[str]:
    """Return the schemas that the help of --json names."""
    helps = [each.help or "" for each in command.params if isinstance(each, click.Option) and "--json" in each.opts]
    return re.findall(r"hiltest\.[a-z-]+/\d+", "".join(helps))


def test_every_command_has_it_and_is_tried_here() -> None:
    without = {name for name, command in every_command() if not schemas_of(command)}
    assert without == {"mcp"}  # its standard output is that of a protocol
    assert {name for name, _ in every_command()} == PRINTING.keys() | ELSEWHERE


def test_the_page_and_the_schemas_are_those_that_their_script_writes() -> None:
    spec = importlib.util.spec_from_file_location("documents_page", DOCS / "documents.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    shipped_schemas = {path: path.read_text(encoding="utf-8") for path in (script.PACKAGE / "schemas").iterdir()}
    assert shipped_schemas == {
        script.schema_file(name): script.schema_text(name, *kinds) for name, kinds in script.DOCUMENTS.items()
    }
    assert script.page() == (DOCS / "json.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory, default_run: Finished) -> Path:
    """A folder with what the commands read."""
    folder = folder_of_all_inputs(tmp_path_factory, default_run)
    assert run("baseline", "save", str(folder / "run.json"), str(folder / "base.json")) == 0
    rig = (shipped() / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    (folder / "field.toml").write_text(f'{rig}\n[world.playback]\nfile = "field.csv"\n', encoding="utf-8")
    turned = np.radians(np.arange(0.0, 720.0, 2.0))
    track = np.column_stack(
        [np.arange(turned.size) / 20.0, 30.0 * np.cos(turned), 30.0 * np.sin(turned), 30.0 * np.cos(3.0 * turned)]
    )
    np.savetxt(folder / "field.csv", track, fmt="%.4f", delimiter=",", header="t_s,mx_uT,my_uT,mz_uT", comments="")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(PRINTING))
def test_standard_output_is_one_document(
    name: str, inputs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(inputs)
    schema, *_others = schemas_of(dict(every_command())[name])
    first, *rest = PRINTING[name]
    assert run(first, *rest, "--json") == 0
    out = capsys.readouterr().out
    checked(out, schema)
    if name == "serve":
        assert out.count("\n") == 1


def hiltest(folder: Path, *words: str) -> tuple[int, str]:
    """Run a command in a process of its own; return its exit code and standard output."""
    given = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    done = subprocess.run(
        [sys.executable, "-m", "hiltest", *words],
        cwd=folder,
        env=given,
        capture_output=True,
        text=True,
        check=False,
        timeout=300.0,
    )
    return done.returncode, done.stdout


@pytest.mark.slow
def test_a_run_and_a_campaign_print_their_records(tmp_path: Path) -> None:
    code, out = hiltest(tmp_path, "run", "--json", "--", "-k", "identity")
    assert code == 0
    assert out == (tmp_path / "hil-out" / "run.json").read_text(encoding="utf-8")
    checked(out, "hiltest.run/1")
    code, out = hiltest(tmp_path, "run", "--seeds", "1..1", "--out", "seeds", "--json", "--", "-k", "identity")
    assert code == 0
    checked(out, "hiltest.seeds/1")


def wrong() -> Iterator[tuple[int, str, tuple[str, ...]]]:
    """Yield the exit code, the error and the command of what cannot be done."""
    yield 4, "UsageError", ("run", "--json", "--rig", "gone")
    yield 4, "UsageError", ("run", "--json", "--", "-p", "no:hiltest")
    yield 4, "NothingRecordedError", ("run", "--json", "--seeds", "1..1", "--baseline", "gone.json")
    yield 4, "NoSuchOption", ("compare", "--json", "--gone")
    yield 4, "NothingRecordedError", ("report", "gone", "--json")
    yield 4, "ConfigError", ("bisect", "v1", "v2", "--firmware", "a.elf", "--json", "--", "make")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "error", "command"), [*wrong()], ids=lambda each: " ".join(each) if isinstance(each, tuple) else ""
)
def test_an_error_is_a_document_too(tmp_path: Path, code: int, error: str, command: tuple[str, ...]) -> None:
    found, out = hiltest(tmp_path, *command)
    assert found == code
    content = checked(out, "hiltest.error/1")
    assert (content["error"], content["exit_code"]) == (error, code)
    assert content["message"] != "no output"


@pytest.mark.slow
def test_a_log_that_ctrl_c_has_ended_prints_its_document(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hiltest", "log", "--seconds", "1e6", "--out", "log.csv", "--json"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        log = tmp_path / "log.csv"
        while running.poll() is None and not (log.exists() and log.stat().st_size > 1000):
            time.sleep(0.05)
        running.send_signal(signal.SIGINT)
        out, _ = running.communicate(timeout=300.0)
    assert running.returncode == 2
    assert checked(out, "hiltest.log/1")["ended_early"]
