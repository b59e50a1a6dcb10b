"""``hiltest ports`` as it is typed, over emulated USB trees."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.command_files import run
from tests.usb_tree import K64F, SECOND_K64F, UsbTree


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> UsbTree:
    monkeypatch.setenv("HILTEST_ROOT", str(tmp_path / "m"))
    return UsbTree(tmp_path / "m")


def test_boards_are_listed_with_port_volume_and_version(tree: UsbTree, capsys: pytest.CaptureFixture[str]) -> None:
    volume = tree.plug_in(disk="sdb", mounted="/media/me/DAPLINK")
    tree.plug_in(serial=SECOND_K64F, tty="ttyACM1", disk="sdc")
    assert run("ports") == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [SECOND_K64F, f"{tree.root}/dev/ttyACM1", "sdc,", "not", "mounted", "unknown"] in rows
    assert [K64F, f"{tree.root}/dev/ttyACM0", str(volume), "0257"] in rows


def test_without_a_board_it_says_what_to_check_and_why_others_were_not_taken(
    tree: UsbTree, capsys: pytest.CaptureFixture[str]
) -> None:
    tree.plug_in(vendor="1366", product="1015", serial="000621000000", name="[red]J-Link\x1b[2J", tty="ttyACM0")
    assert run("ports") == 0
    said = capsys.readouterr().out
    assert "OpenSDA" in said
    assert "[red]J-Link⟨U+001B⟩[2J" in said
    assert "put DAPLink on it" in said


def test_the_document_has_what_is_there_and_null_for_what_is_not(
    tree: UsbTree, capsys: pytest.CaptureFixture[str]
) -> None:
    tree.plug_in(tty=None)
    tree.built_in("ttyS0")
    assert run("ports", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["boards"] == [
        {
            "serial_number": K64F,
            "usb_id": "0d28:0204",
            "product": "DAPLink CMSIS-DAP",
            "port": None,
            "volume": None,
            "daplink_version": None,
        }
    ]
    (other,) = document["others"]
    assert other["port"] == f"{tree.root}/dev/ttyS0"
    assert other["serial_number"] is None
