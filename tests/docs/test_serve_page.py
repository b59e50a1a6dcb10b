"""The page about served boards: its commands start, its example runs, and its tables are what the table answers."""

from __future__ import annotations

import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.boards.gcode import Refusal
from hiltest.boards.simulated_grbl import HELP
from hiltest.rig.rig_file import load_rig

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "serve.md").read_text(encoding="utf-8")
COMMANDS = [line for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S) for line in block.splitlines()]
(EXAMPLE,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
WALL_LIMIT_S = 60.0  # for what takes a second


class Server:
    """A command of the page as a process; its ports are any free ones, so that others may run beside it."""

    def __init__(self, command: str, folder: Path) -> None:
        arguments = shlex.split(command.replace("--tcp 6464", "--tcp 0"))[1:]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hiltest", *arguments],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        self.printed = [self.process.stdout.readline() for _ in range(2)]

    def end(self) -> tuple[int, str]:
        self.process.send_signal(signal.SIGINT)
        _, answer = self.process.communicate(timeout=WALL_LIMIT_S)
        return self.process.returncode, answer


@pytest.fixture
def tcp_ports(tmp_path: Path) -> Iterator[list[str]]:
    server = Server("hiltest serve --tcp 6464", tmp_path)
    yield [line.rpartition(":")[2].strip() for line in server.printed]
    server.end()


@pytest.mark.parametrize("command", [command for command in COMMANDS if command.startswith("hiltest serve")])
def test_every_server_starts_prints_its_ports_and_ends(command: str, tmp_path: Path) -> None:
    server = Server(command, tmp_path)
    code, answer = server.end()
    assert code == 0, answer
    assert [line.partition(": ")[0] for line in server.printed] == ["board", "turntable"]


def test_every_run_is_understood(tmp_path: Path) -> None:
    runs = [command for command in COMMANDS if command.startswith("hiltest run")]
    assert runs
    for command in runs:
        arguments = [*shlex.split(command)[1:], "--", "--collect-only", "-q"]
        done = run_module("hiltest", *arguments, folder=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr


def test_the_example_runs(tcp_ports: list[str]) -> None:
    exec(compile(EXAMPLE.replace("6465", tcp_ports[1]), "docs/serve.md", "exec"), {})


def test_the_tables_name_every_error_and_every_command() -> None:
    rows = re.findall(r"^\| ([\d, ]+) \|", PAGE, re.M)
    assert {int(number) for row in rows for number in row.split(",")} == set(Refusal)
    commands = re.findall(r"^\| (`.*?) \|", PAGE, re.M)
    assert all(f"`{word}`" in " ".join(commands) for word in ("$$", "$G", "$I", "$X", "$H", "~", "!", "?", "$"))
    assert HELP == "[HLP:$$ $G $I $X $H ~ ! ? ctrl-x]"


def test_the_rig_keys_are_keys_of_a_rig(tmp_path: Path) -> None:
    rig = (ROOT / "hil" / "rigs" / "served-k64f.toml").read_text(encoding="utf-8")
    for keys in re.findall(r"^```toml\n(\[.*?)^```", PAGE, re.M | re.S):
        table = keys.splitlines()[0]
        before, rest = rig.split(table + "\n")
        rig = before + keys + "\n" + rest[rest.index("\n[") :]
    (tmp_path / "bench.toml").write_text(rig, encoding="utf-8")
    loaded = load_rig(tmp_path / "bench.toml")
    assert (loaded.turntable.kind, loaded.turntable.port) == ("grbl", "/dev/ttyUSB0")
    assert loaded.board.cycle_model == "cortex-m4-trm/3"
