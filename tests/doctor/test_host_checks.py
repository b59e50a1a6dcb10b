"""What stands between a program and a board, in emulated machines: found, and with a remedy that helps."""

from __future__ import annotations

import grp
import os
import tempfile
from pathlib import Path

import pytest
from tests.usb_tree import K64F, UsbTree

from hiltest.doctor.check import Health
from hiltest.doctor.host_checks import (
    HOST_CHECKS,
    RULES,
    HostPort,
    host_port,
    see_board,
    see_daplink,
    see_holders,
    see_modem_manager,
    see_permission,
    see_rules,
    see_volume,
)
from hiltest.rig.bench_files import shipped

from .conftest import NOBODY, held_by_a_process


def plugged(tree: UsbTree, tty: str = "ttyACM0") -> HostPort:
    return host_port(tree.root / "dev" / tty, tree.root)


def process(tree: UsbTree, number: int, command: str, *opened: Path) -> None:
    """Let a process run in an emulated machine."""
    folder = tree.root / "proc" / str(number)
    (folder / "fd").mkdir(parents=True)
    (folder / "comm").write_text(f"{command}\n")
    for descriptor, item in enumerate(opened):
        (folder / "fd" / str(descriptor)).symlink_to(item)


def test_a_bench_as_it_should_be_is_all_right(tree: UsbTree) -> None:
    tree.plug_in(disk="sdb", mounted="/media/me/DAPLINK")
    rules = tree.root / "etc/udev/rules.d" / RULES
    rules.parent.mkdir(parents=True)
    rules.write_bytes((shipped() / "udev" / RULES).read_bytes())
    checks = [look(plugged(tree)) for look in HOST_CHECKS.values()]
    assert [(check.name, check.health) for check in checks] == [(name, Health.OK) for name in HOST_CHECKS]
    assert K64F in checks[0].finding
    assert "0257" in checks[1].finding


def test_a_port_that_is_no_board_s_is_named_and_a_link_to_one_is_followed(tree: UsbTree) -> None:
    tree.plug_in(vendor="0403", product="6001", serial="A50285BI", name="FT232R", tty="ttyUSB0")
    result = see_board(plugged(tree, "ttyUSB0"))
    assert result.health is Health.WARNING
    assert "0403:6001" in result.finding
    tree.plug_in()
    link = tree.root / "dev/board"
    link.symlink_to("ttyACM0")
    assert K64F in see_board(host_port(link, tree.root)).finding


def test_a_port_off_usb_leaves_out_what_is_about_usb(tree: UsbTree) -> None:
    tree.built_in("ttyS0")
    checks = {name: look(plugged(tree, "ttyS0")).health for name, look in HOST_CHECKS.items()}
    assert {name for name, health in checks.items() if health is Health.OK} == {"permission", "port"}
    assert {*checks.values()} == {Health.OK, Health.NOT_LOOKED_AT}


@pytest.mark.parametrize(
    ("drive", "message"),
    [
        ({}, "has no drive"),
        ({"disk": "sdb"}, "sdb is not mounted"),
        ({"disk": "sdb", "mounted": "/m/D", "options": "ro"}, "read-only"),
    ],
)
def test_a_drive_that_firmware_cannot_be_dropped_onto(tree: UsbTree, drive: dict[str, str], message: str) -> None:
    tree.plug_in(**drive)
    result = see_volume(plugged(tree))
    assert result.health is Health.WARNING
    assert message in result.finding
    assert result.remedy


@pytest.mark.parametrize("details", ["", "Interface Version: 0244\r\n", "Interface Version: 0226\r\n"])
def test_firmware_from_before_daplink_and_of_known_faults_is_a_warning(tree: UsbTree, details: str) -> None:
    tree.plug_in(disk="sdb", mounted="/m/D", details=details)
    result = see_daplink(plugged(tree))
    assert result.health is Health.WARNING
    assert "daplink.io" in result.remedy


def test_a_port_that_this_user_may_not_use_says_what_gives_access(as_nobody: None) -> None:
    with tempfile.TemporaryDirectory() as folder:
        tree = UsbTree(Path(folder) / "machine")
        tree.plug_in()
        (tree.root / "dev/ttyACM0").chmod(0)
        result = see_permission(plugged(tree))
        assert result.health is Health.FAILED
        assert "udev rules" in result.remedy
        (tree.root / "dev/ttyACM0").chmod(0o660)
        assert see_permission(plugged(tree)).health is Health.OK


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file to a group")
def test_a_group_of_devices_is_named_and_root_s_is_not(as_nobody: None) -> None:
    with tempfile.TemporaryDirectory() as folder:
        tree = UsbTree(Path(folder) / "machine")
        tree.plug_in()
        node, messages = tree.root / "dev/ttyACM0", {}
        for group in ("dialout", "root"):
            os.seteuid(0)
            os.chown(node, 0, grp.getgrnam(group).gr_gid)
            node.chmod(0o660)
            os.seteuid(NOBODY)
            messages[group] = see_permission(plugged(tree))
    assert {message.health for message in messages.values()} == {Health.FAILED}
    assert "usermod -aG dialout" in messages["dialout"].remedy
    assert "usermod" not in messages["root"].remedy


def test_a_port_that_does_not_exist(tree: UsbTree) -> None:
    assert see_permission(plugged(tree, "ttyACM7")).health is Health.FAILED


def test_rules_that_are_missing_or_of_another_version_come_with_the_command_that_installs_them(tree: UsbTree) -> None:
    tree.plug_in()
    missing = see_rules(plugged(tree))
    rules = tree.root / "usr/lib/udev/rules.d" / RULES
    rules.parent.mkdir(parents=True)
    rules.write_text("# older\n")
    other = see_rules(plugged(tree))
    assert (missing.health, other.health) == (Health.WARNING, Health.WARNING)
    assert str(rules) in other.finding
    for item in (missing, other):
        assert f"install -m 644 {shipped() / 'udev' / RULES} /etc/udev/rules.d/" in item.remedy


def test_modem_manager_is_a_warning_until_udev_keeps_it_from_the_port(tree: UsbTree) -> None:
    tree.plug_in()
    assert see_modem_manager(plugged(tree)).health is Health.OK
    process(tree, 611, "ModemManager")
    assert see_modem_manager(plugged(tree)).health is Health.WARNING
    stored = tree.root / "run/udev/data/c166:0"
    stored.parent.mkdir(parents=True)
    stored.write_text("S:hiltest/0240\nE:ID_BUS=usb\nE:ID_MM_DEVICE_IGNORE=1\n")
    assert see_modem_manager(plugged(tree)).health is Health.OK


def test_the_program_that_holds_a_port_is_named_with_its_process(tree: UsbTree) -> None:
    tree.plug_in()
    process(tree, 4711, "minicom", Path("/dev/null"), tree.root / "dev/ttyACM0")
    process(tree, 4712, "bash", Path("/dev/null"))
    result = see_holders(plugged(tree))
    assert result.health is Health.FAILED
    assert "minicom (process 4711)" in result.finding
    assert result.remedy.endswith("kill 4711")
    assert "4712" not in result.finding


def test_a_real_process_that_holds_a_real_terminal_is_found() -> None:
    far, near = os.openpty()
    port = HostPort(Path("/"), Path(os.ttyname(near)), None)
    os.close(near)
    assert see_holders(port).health is Health.OK
    assert port.path is not None
    with held_by_a_process(port.path) as pid:
        result = see_holders(port)
    os.close(far)
    assert result.health is Health.FAILED
    assert f"(process {pid})" in result.finding
