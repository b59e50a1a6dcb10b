"""Boards are found by the USB identity of their DAPLink, in trees as Linux shows them."""

from __future__ import annotations

import os
import tempfile
import unicodedata
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.usb_tree import DETAILS, K64F, SECOND_K64F, UsbTree

from hiltest.boards.daplink import choose_board, find_boards, plugged_in
from hiltest.errors import NoBoardError, SeveralBoardsError


@pytest.fixture
def tree(tmp_path: Path) -> UsbTree:
    return UsbTree(tmp_path)


def test_a_machine_without_usb_has_no_boards(tmp_path: Path) -> None:
    assert plugged_in(tmp_path).boards == plugged_in(tmp_path).others == ()


def test_a_board_is_found_with_its_port_its_volume_and_the_version_of_its_daplink(tree: UsbTree) -> None:
    volume = tree.plug_in(disk="sdb", mounted="/media/me/DAPLINK")
    (board,) = find_boards(tree.root)
    assert (board.usb_id, board.board_id, board.serial_number) == ("0d28:0204", "0240", K64F)
    assert board.port == tree.root / "dev/ttyACM0"
    assert board.volume is not None
    assert (board.volume.path, board.volume.interface_version, board.volume.unique_id) == (volume, "0257", K64F)
    assert not board.volume.read_only


def test_a_volume_is_found_behind_a_space_a_partition_and_a_read_only_mount(tree: UsbTree) -> None:
    volume = tree.plug_in(disk="sdb", mounted="/media/a b/DAPLINK", partition=True, options="ro,nosuid")
    (board,) = find_boards(tree.root)
    assert board.volume is not None
    assert board.volume.path == volume
    assert board.volume.read_only


def test_a_drive_that_is_not_mounted_is_named(tree: UsbTree) -> None:
    tree.plug_in(disk="sdb")
    (board,) = find_boards(tree.root)
    assert board.disks == ("sdb",)
    assert board.volume is None


def test_a_board_without_its_serial_port_is_a_board_still(tree: UsbTree) -> None:
    tree.plug_in(tty=None)
    (board,) = find_boards(tree.root)
    assert board.port is None


def test_boards_behind_one_another_keep_their_own_ports(tree: UsbTree) -> None:
    tree.plug_in(serial=K64F, tty="ttyACM1")
    tree.plug_in(serial=SECOND_K64F, tty="ttyACM0")
    results = {board.serial_number: board.port for board in find_boards(tree.root)}
    assert results == {K64F: tree.root / "dev/ttyACM1", SECOND_K64F: tree.root / "dev/ttyACM0"}


def test_other_ports_say_why_they_are_not_taken(tree: UsbTree) -> None:
    tree.plug_in(serial="9904360258824e45", tty="ttyACM0")
    tree.plug_in(vendor="1366", product="1015", serial="000621000000", name="J-Link", tty="ttyACM1")
    tree.plug_in(vendor="0403", product="6001", serial="A50285BI", name="FT232R USB UART", tty="ttyUSB0")
    tree.plug_in(serial="0000000029304e45", tty=None)
    tree.plug_in(serial=None, tty="ttyACM2")
    tree.built_in("ttyS0")
    tree.built_in("ttyS1", kind="0")
    result = plugged_in(tree.root)
    assert result.boards == ()
    messages = {other.port.name if other.port else None: other.not_taken for other in result.others}
    assert messages.keys() == {"ttyACM0", "ttyACM1", "ttyACM2", "ttyUSB0", "ttyS0", None}
    assert "9904" in messages["ttyACM0"]
    assert "SEGGER" in messages["ttyACM1"]
    assert "no serial number" in messages["ttyACM2"]
    assert "0403:6001" in messages["ttyUSB0"]
    assert "not on USB" in messages["ttyS0"]
    assert "reset button" in messages[None]


@pytest.mark.parametrize("beginning", [SECOND_K64F, SECOND_K64F[:12]])
def test_a_board_is_chosen_by_its_serial_number_or_the_beginning_of_it(tree: UsbTree, beginning: str) -> None:
    tree.plug_in(serial=K64F, tty="ttyACM0")
    tree.plug_in(serial=SECOND_K64F, tty="ttyACM1")
    assert choose_board(beginning, root=tree.root).serial_number == SECOND_K64F


def test_the_one_board_needs_no_choice_and_two_do(tree: UsbTree) -> None:
    with pytest.raises(NoBoardError):
        choose_board(root=tree.root)
    tree.plug_in()
    assert choose_board(root=tree.root).serial_number == K64F
    with pytest.raises(NoBoardError, match=K64F):
        choose_board("0240ffff", root=tree.root)
    tree.plug_in(serial=SECOND_K64F, tty="ttyACM1")
    with pytest.raises(SeveralBoardsError, match=f"{SECOND_K64F}.*usb://"):
        choose_board(root=tree.root)


def test_what_devices_and_volumes_say_of_themselves_is_cut_and_made_legible(tree: UsbTree) -> None:
    tree.plug_in(
        serial="0240\x1b[2J\u202e" + "7" * 500,
        name="DAP\x07Link",
        disk="sdb",
        mounted="/m/D",
        details=DETAILS.format(serial="\x1b]0;owned\x07", version="9" * 3000),
    )
    (board,) = find_boards(tree.root)
    assert board.volume is not None
    texts = (board.serial_number, board.product, board.volume.interface_version, board.volume.unique_id)
    assert all(text.isprintable() and len(text) < 200 for text in texts)
    assert board.serial_number.startswith("0240⟨U+001B⟩[2J⟨U+202E⟩777")


@given(serial=st.binary(max_size=300), details=st.binary(max_size=300), mounts=st.binary(max_size=300))
@settings(max_examples=50)
def test_whatever_a_device_and_a_mount_are_called_boards_are_found(
    serial: bytes, details: bytes, mounts: bytes
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        tree = UsbTree(Path(folder) / "machine")
        volume = tree.plug_in(disk="sdb", mounted="/m/D")
        (device,) = (tree.root / "sys/devices/pci0000:00/0000:00:14.0/usb1").glob("1-*")
        (device / "serial").write_bytes(b"0240" + serial)
        (volume / "DETAILS.TXT").write_bytes(b"Interface Version: " + details)
        with (tree.root / "proc/self/mountinfo").open("ab") as file:
            file.write(mounts)
        (board,) = plugged_in(tree.root).boards
    assert board.volume is not None
    for text in (board.serial_number, board.volume.interface_version):
        assert {unicodedata.category(item) for item in text} & {"Cc", "Cf", "Cs", "Zl", "Zp"} == set()


def test_a_volume_whose_details_are_a_link_or_a_pipe_is_read_no_further(tree: UsbTree, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("Interface Version: 0042\n")
    linked = tree.plug_in(serial=K64F, disk="sdb", mounted="/m/linked") / "DETAILS.TXT"
    linked.unlink()
    linked.symlink_to(secret)
    piped = tree.plug_in(serial=SECOND_K64F, tty="ttyACM1", disk="sdc", mounted="/m/piped") / "DETAILS.TXT"
    piped.unlink()
    os.mkfifo(piped)
    assert [board.volume.interface_version for board in find_boards(tree.root) if board.volume] == ["", ""]
