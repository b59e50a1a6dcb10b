"""Builds what Linux shows of plugged-in USB devices, below a temporary root: sysfs, /proc and /dev, with its links."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

# As DAPLink's DETAILS.TXT is, with its line ends.
DETAILS = (
    "# DAPLink Firmware - see https://mbed.com/daplink\r\nUnique ID: {serial}\r\nHIC ID: 97969900\r\n"
    "Auto Reset: 1\r\nDaplink Mode: Interface\r\nInterface Version: {version}\r\nUSB Interfaces: MSD, CDC, HID\r\n"
)
K64F = "0240000034544e45004580058ff8000d4ca1000097969900"
SECOND_K64F = "0240000032044e4500257009997b00386781000097969900"


@dataclass
class UsbTree:
    """An empty machine; its methods plug things in."""

    root: Path
    _devices: int = 0

    def __post_init__(self) -> None:
        for folder in ("sys/bus/usb/devices", "sys/class/tty", "proc/self", "dev"):
            (self.root / folder).mkdir(parents=True)
        (self.root / "proc/self/mountinfo").write_text("22 1 8:1 / / rw,relatime - ext4 /dev/sda1 rw\n")
        self._write("sys/devices/pci0000:00/0000:00:14.0/usb1", idVendor="1d6b", idProduct="0002", product="xHCI")
        self._link("sys/bus/usb/devices/usb1", "sys/devices/pci0000:00/0000:00:14.0/usb1")

    def plug_in(
        self,
        *,
        vendor: str = "0d28",
        product: str = "0204",
        serial: str | None = K64F,
        name: str = "DAPLink CMSIS-DAP",
        tty: str | None = "ttyACM0",
        behind: Path | None = None,
        disk: str | None = None,
        mounted: str | None = None,
        options: str = "rw,nosuid",
        details: str | None = None,
        partition: bool = False,
    ) -> Path:
        """Plug in a device; return its volume's folder, or the root's.

        `behind` is what its /dev node leads to; `details` the content of DETAILS.TXT, by default DAPLink's own.
        """
        self._devices += 1
        number = self._devices
        device = f"sys/devices/pci0000:00/0000:00:14.0/usb1/1-{number}"
        attributes = {"idVendor": vendor, "idProduct": product, "product": name}
        self._write(device, **attributes, **({} if serial is None else {"serial": serial}))
        self._link(f"sys/bus/usb/devices/1-{number}", device)
        for interface in (0, 1):
            self._write(f"{device}/1-{number}:1.{interface}", bInterfaceNumber=f"{interface:02d}")
            self._link(f"sys/bus/usb/devices/1-{number}:1.{interface}", f"{device}/1-{number}:1.{interface}")
        if tty:
            between = f"{tty}/tty" if tty.startswith("ttyUSB") else "tty"
            self._tty(tty, f"{device}/1-{number}:1.1/{between}/{tty}", f"{device}/1-{number}:1.1", behind)
        if disk is None:
            return self.root
        block = f"{device}/1-{number}:1.0/host{number}/target{number}:0:0/{number}:0:0:0/block/{disk}"
        minors = f"8:{16 * number}"
        self._write(block, dev=minors, removable="1")
        if partition:
            minors = f"8:{16 * number + 1}"
            self._write(f"{block}/{disk}1", dev=minors)
        if mounted is None:
            return self.root
        with (self.root / "proc/self/mountinfo").open("a") as file:
            escaped = mounted.replace(" ", "\\040")
            file.write(f"{90 + number} 22 {minors} / {escaped} {options} shared:1 - vfat /dev/{disk} rw,uid=1000\n")
        volume = self.root / mounted.lstrip("/")
        volume.mkdir(parents=True)
        written = DETAILS.format(serial=serial, version="0257") if details is None else details
        (volume / "DETAILS.TXT").write_text(written, newline="")
        return volume

    def built_in(self, tty: str, *, kind: str = "4") -> None:
        """Add a serial port of the machine itself; `kind` 0 is one that its driver has a name for, and no hardware."""
        device = f"sys/devices/pnp0/00:01/{tty}"
        self._tty(tty, f"{device}/tty/{tty}", device, None)
        (self.root / device / "tty" / tty / "type").write_text(f"{kind}\n")

    def _tty(self, name: str, folder: str, device: str, behind: Path | None) -> None:
        self._write(folder, dev="166:0")
        self._link(f"{folder}/device", device)
        self._link(f"sys/class/tty/{name}", folder)
        node = self.root / "dev" / name
        if behind:
            node.symlink_to(behind)
        else:
            node.touch()

    def _write(self, folder: str, **attributes: str) -> None:
        (self.root / folder).mkdir(parents=True, exist_ok=True)
        for name, value in attributes.items():
            (self.root / folder / name).write_text(f"{value}\n", encoding="utf-8")

    def _link(self, name: str, target: str) -> None:
        place = self.root / name
        place.symlink_to(Path(*[".."] * (len(place.parent.relative_to(self.root).parts))) / target)
