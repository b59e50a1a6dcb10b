"""``hiltest doctor`` as it is typed: a line a check, a remedy below what is wrong, and exit codes."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.command_files import run
from tests.usb_tree import UsbTree


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> UsbTree:
    monkeypatch.setenv("HILTEST_ROOT", str(tmp_path / "machine"))
    return UsbTree(tmp_path / "machine")


def test_a_bench_without_a_board_ends_with_20_and_a_remedy(tree: UsbTree, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("doctor") == 20
    failed, remedy, *left_out = capsys.readouterr().out.splitlines()
    assert failed.startswith("FAILED         board  ")
    assert remedy.strip().startswith("-> ")
    # What was left out for one reason is one line.
    assert [line.rpartition(": ")[2] for line in left_out if line.startswith("not looked at") and ": " in line][:2] == [
        "no board is present",
        "the port cannot be used",
    ]


def test_a_port_that_does_not_exist_ends_with_4_as_it_does_for_a_run(tree: UsbTree) -> None:
    assert run("doctor", "--port", "/dev/nope") == 4


def test_two_boards_end_with_4_and_how_to_name_one(tree: UsbTree, capsys: pytest.CaptureFixture[str]) -> None:
    tree.plug_in()
    tree.plug_in(serial="0240ffff", tty="ttyACM1")
    assert run("doctor") == 4
    assert "--port usb://0240" in capsys.readouterr().err


def test_firmware_with_a_language_of_its_own_is_left_to_the_command_that_understands_it(
    tree: UsbTree, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("doctor", "--rig", "text-compass") == 0
    assert "hiltest listen" in capsys.readouterr().out
