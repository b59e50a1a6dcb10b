"""Checks between a program and a board on this machine: device, drive, permission, rules, other programs."""

from __future__ import annotations

import contextlib
import grp
import os
import pwd
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from hiltest.boards.daplink import NO_PORT, UsbBoard, plugged_in
from hiltest.doctor.check import Check, failed, not_looked_at, ok, warning
from hiltest.rig.bench_files import shipped
from hiltest.run_record.exit_codes import ExitCode
from hiltest.text import join_words, legible

RULES = "70-hiltest.rules"
_RULES_FOLDERS = ("etc", "run", "usr/local/lib", "usr/lib", "lib")
# DAPLink's history: 0244 fixes serial ports that got stuck, and a crash if data came while it started. With 0244 drag
# and drop to a K64F fails at times under Linux (its issue 347); the next release for the K64F was 0246.
_SOUND_DAPLINK = 246
_GROUP_MAY = stat.S_IRGRP | stat.S_IWGRP
_MODEM_MANAGER = "ModemManager"
_LOOKED_UP = ("ID_MM_DEVICE_IGNORE=1", "ID_MM_PORT_IGNORE=1")


@dataclass(frozen=True, slots=True)
class HostPort:
    """A serial device of this machine, or of one below another root, and its USB board."""

    root: Path
    """Folder with ``sys``, ``proc``, ``dev`` and ``etc``."""
    path: Path | None
    """Path of the device; None for a board without a port."""
    device: UsbBoard | None
    """USB board of the port; None for a port that is not on USB."""

    @property
    def daplink(self) -> UsbBoard | None:
        """The USB board, if it is a DAPLink."""
        return self.device if self.device and self.device.is_daplink else None


def host_port(path: Path, root: Path) -> HostPort:
    """Return the USB board of a serial device; links to it are followed."""
    plugged = plugged_in(root)
    devices = [*plugged.boards, *(other.device for other in plugged.others if other.device)]
    real = os.path.realpath(path)
    device = next((candidate for candidate in devices if real in map(os.path.realpath, candidate.ports)), None)
    return HostPort(root, path, device)


def see_board(port: HostPort) -> Check:
    """Check which board the port belongs to."""
    if port.device is None:
        return not_looked_at("board", f"{port.path} is not a USB port, so its board is unknown")
    if port.device.not_taken:
        finding = f"{port.path}: {port.device.not_taken}"
        return warning("board", finding, "name a board of `hiltest ports` with --port")
    if port.path is None:
        return failed("board", f"FRDM-K64F {port.device.serial_number} has no serial port", NO_PORT)
    return ok("board", f"FRDM-K64F {port.device.serial_number} on {port.path}")


def see_daplink(port: HostPort) -> Check:
    """Check the firmware of the interface chip."""
    if port.daplink is None:
        return not_looked_at("DAPLink", _no_daplink_reason(port))
    if port.daplink.volume is None:
        return not_looked_at("DAPLink", "its drive, which has the version, is not mounted")
    version = port.daplink.volume.interface_version
    if not version:
        finding = f"{port.daplink.volume.path} has no version: it is older than DAPLink, or not a DAPLink"
    elif version.isdecimal() and int(version) < _SOUND_DAPLINK:
        finding = f"firmware {version}: before 0244 the serial port may get stuck, and in 0244 the drive"
    else:
        return ok("DAPLink", f"firmware {version}")
    return warning(
        "DAPLink",
        finding,
        "plug it in with its reset button held, and copy the FRDM-K64F's file of "
        "https://daplink.io onto the drive that appears",
    )


def see_volume(port: HostPort) -> Check:
    """Check that firmware could be dropped onto the board's drive."""
    if port.daplink is None:
        return not_looked_at("volume", _no_daplink_reason(port))
    volume, disks = port.daplink.volume, port.daplink.disks
    if not disks:
        return warning("volume", "DAPLink has no drive", "use hiltest flash --probe pyocd, which needs no drive")
    if volume is None:
        return warning("volume", f"{disks[0]} is not mounted", f"udisksctl mount -b /dev/{disks[0]}")
    if volume.read_only:
        return warning("volume", f"{volume.path} is mounted read-only", "plug the board in again")
    return ok("volume", f"{volume.path}")


def see_permission(port: HostPort) -> Check:
    """Check that this user may use the port."""
    if port.path is None:
        return not_looked_at("permission", "no serial port is present")
    try:
        status = port.path.stat()
    except OSError as error:
        remedy = "name a port that `hiltest ports` lists"
        return failed("permission", f"{port.path}: {error.strerror}", remedy, ExitCode.USAGE_ERROR)
    if os.access(port.path, os.R_OK | os.W_OK, effective_ids=True):
        return ok("permission", f"{port.path} can be read and written")
    return failed("permission", f"{port.path} is not readable and writable for this user", _access_remedy(port, status))


def _access_remedy(port: HostPort, status: os.stat_result) -> str:
    """Return a remedy that gives a user access: the port's group, if it is one of devices and may read and write."""
    rules = f"install the udev rules: {install_rules()}"
    if status.st_gid == 0 or status.st_mode & _GROUP_MAY != _GROUP_MAY:
        return rules if port.daplink else f"sudo chmod a+rw {port.path}"
    try:
        group, user = grp.getgrgid(status.st_gid), pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return rules
    if user in group.gr_mem:
        return f"log in again, since you joined the group {group.gr_name} after this login"
    return f"sudo usermod -aG {group.gr_name} $USER, then log in again"


def see_rules(port: HostPort) -> Check:
    """Check that hiltest's udev rules are installed."""
    if port.daplink is None:
        return not_looked_at("udev rules", _no_daplink_reason(port))
    ours = (shipped() / "udev" / RULES).read_bytes()
    for folder in _RULES_FOLDERS:
        file = port.root / folder / "udev/rules.d" / RULES
        with contextlib.suppress(OSError):
            if file.read_bytes() == ours:
                return ok("udev rules", f"installed as {file}")
            return warning("udev rules", f"{file} belongs to another version of hiltest", install_rules())
    return warning("udev rules", f"{RULES} is not installed", install_rules())


def install_rules() -> str:
    """Return the command that installs the rules."""
    return (
        f"sudo install -m 644 {shipped() / 'udev' / RULES} /etc/udev/rules.d/ && sudo udevadm control --reload && "
        "sudo udevadm trigger"
    )


def flash_command(port: HostPort) -> str:
    """Return the command that flashes hiltest's firmware onto the board on a port."""
    if port.device and not port.device.not_taken:
        return f"hiltest flash --port usb://{port.device.serial_number}"
    return f"hiltest flash --port {port.path} --probe pyocd"


def see_modem_manager(port: HostPort) -> Check:
    """Check that ModemManager does not write to the port when the board is plugged in."""
    name = "ModemManager"
    if port.daplink is None or port.path is None:
        return not_looked_at(name, _no_daplink_reason(port))
    if _MODEM_MANAGER not in (_command(process) for process in _processes(port.root)):
        return ok(name, "does not run")
    number = _text(port.root / "sys/class/tty" / Path(os.path.realpath(port.path)).name / "dev")
    udev_lines = _text(port.root / "run/udev/data" / f"c{number}").splitlines()
    if any(line.removeprefix("E:") in _LOOKED_UP for line in udev_lines):
        return ok(name, "runs, and does not use this port")
    return warning(name, "runs, and writes to each board for half a minute after it is plugged in", install_rules())


def see_holders(port: HostPort) -> Check:
    """Check that no other program has the port open, since each would receive part of the board's output."""
    if port.path is None:
        return not_looked_at("port", "there is none")
    real, holders, unseen = os.path.realpath(port.path), {}, 0
    for process in _processes(port.root):
        try:
            opened = [*(process / "fd").iterdir()]
        except PermissionError:
            unseen += 1
            continue
        except OSError:
            continue  # the process has ended
        if process.name != str(os.getpid()) and any(_link_target(descriptor) == real for descriptor in opened):
            holders[process.name] = f"{_command(process)} (process {process.name})"
    if holders:
        finding = f"{port.path} is held by {join_words([*holders.values()], 3)}"
        return failed("port", finding, f"close that program, or: kill {' '.join(holders)}")
    return ok(
        "port", f"no program has {port.path} open" + (", among the programs that this user can see" if unseen else "")
    )


HOST_CHECKS: dict[str, Callable[[HostPort], Check]] = {
    "board": see_board,
    "DAPLink": see_daplink,
    "volume": see_volume,
    "permission": see_permission,
    "udev rules": see_rules,
    "ModemManager": see_modem_manager,
    "port": see_holders,
}


def _no_daplink_reason(port: HostPort) -> str:
    return f"{port.path} does not belong to a DAPLink" if port.path else "no serial port is present"


def _processes(root: Path) -> Iterator[Path]:
    with contextlib.suppress(OSError):
        yield from (process for process in sorted((root / "proc").iterdir()) if process.name.isdigit())


def _command(process: Path) -> str:
    return legible(_text(process / "comm"))


def _link_target(descriptor: Path) -> str:
    try:
        return os.readlink(descriptor)
    except OSError:
        return ""


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
