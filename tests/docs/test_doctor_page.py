"""The page about ports and doctor: its commands print what it shows, and its table has the checks there are."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from tests.boards.conftest import pty_board, rig  # noqa: F401  # fixtures
from tests.command_files import run
from tests.usb_tree import UsbTree

from hiltest.boards import default_firmware
from hiltest.doctor.board_checks import BOARD_CHECKS
from hiltest.doctor.field_checks import model_field, see_declared_field
from hiltest.doctor.host_checks import HOST_CHECKS
from hiltest.rig import Rig
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "doctor.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^```sh\nhiltest (.*?)\n```", PAGE, re.M | re.S)
PORTS, DOCTOR, OTHER_FIRMWARE, DECLARED, _MEASURED = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)
# In wall time no two runs are alike.
MEASURED = re.compile(r"^ok +(clock|[a-z]+ noise) .*$|text comes: .*$", re.M)


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> UsbTree:
    """The machine that the page shows, without a board behind its port."""
    result = UsbTree(tmp_path / "machine")
    monkeypatch.setenv("HILTEST_ROOT", str(result.root))
    return result


def plug_in(tree: UsbTree, board: Path) -> None:
    tree.plug_in(behind=board, disk="sdb", mounted="/media/me/DAPLINK")
    tree.plug_in(vendor="0403", product="6001", serial="A50285BI", name="FT232R USB UART", tty="ttyUSB0")
    tree.plug_in(serial="9904360258824e45004a5012a8a1b0c9", name="BBC micro:bit CMSIS-DAP", tty="ttyACM1")
    tree.built_in("ttyS0")


def as_on_the_page(text: str, tree: UsbTree) -> list[str]:
    """Return lines without the tree's place, the widths of columns, and what is measured in wall time."""
    text = text.replace(str(tree.root), "").replace(str(shipped()), "HIL")
    text = MEASURED.sub(lambda line: re.sub(r"[-\d][\d.]*", "0", line[0]), text)
    return [re.sub(" {2,}", "  ", line) for line in text.splitlines()]


def test_ports_prints_what_the_page_shows(tree: UsbTree, capsys: pytest.CaptureFixture[str]) -> None:
    plug_in(tree, Path("/dev/null"))
    assert run(*shlex.split(COMMANDS[0])) == 0
    assert as_on_the_page(capsys.readouterr().out, tree) == as_on_the_page(PORTS, tree)


def test_doctor_prints_what_the_page_shows(
    pty_board: Callable[[Rig], Any],  # noqa: F811 (the fixture)
    rig: Rig,  # noqa: F811 (the fixture)
    tree: UsbTree,
    capsys: pytest.CaptureFixture[str],
) -> None:
    plug_in(tree, Path(pty_board(rig).path))
    assert run(*shlex.split(COMMANDS[1])) == 0
    answer = as_on_the_page(capsys.readouterr().out, tree)
    shown = as_on_the_page(DOCTOR, tree)
    if not any(line.startswith("ok  clock") for line in answer):  # on a machine that is too busy for a paced board
        answer = [line for line in answer if "too busy" not in line and "  clock" not in line]
        shown = [line for line in shown if "  clock" not in line]
    assert answer == shown


def test_doctor_says_of_other_firmware_what_the_page_shows(
    pty_board: Callable[..., Any],  # noqa: F811 (the fixture)
    rig: Rig,  # noqa: F811 (the fixture)
    tree: UsbTree,
    capsys: pytest.CaptureFixture[str],
) -> None:
    plug_in(tree, Path(pty_board(rig, default_firmware().with_name("compass-lines.elf")).path))
    assert run("doctor") == 23
    answer, shown = (as_on_the_page(text, tree) for text in (capsys.readouterr().out, OTHER_FIRMWARE))
    begins = answer.index(shown[0])
    assert answer[begins : begins + len(shown)] == shown


def test_the_field_of_the_place_on_the_page_is_compared_as_it_shows() -> None:
    (text,) = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)
    default = load_rig(shipped() / "rigs" / "frdm-k64f.toml")
    placed = replace(default, field=replace(default.field, **tomllib.loads(text)["field"]))
    result = see_declared_field(placed, model_field(placed, date(2026, 11, 26)))
    first, second = DECLARED.splitlines()
    assert first.split(maxsplit=3) == [result.health, *result.name.split(), result.finding]
    assert second.strip() == f"-> {result.remedy}"


def test_the_table_has_every_check_in_its_order() -> None:
    names = re.findall(r"^\| ([A-Za-z ]+) \| (?!examines)", PAGE, re.M)
    assert names == [*HOST_CHECKS, "turntable", "poses", "answer", *BOARD_CHECKS, "measured field", "declared field"]
