"""pyOCD programs a virtual board: its flash algorithm runs there, and what is in the flash then is read back."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.command_files import run
from tests.flashing.test_flash_image import binary
from tests.test_json_documents import checked
from tests.usb_tree import K64F, UsbTree

from hiltest.boards import default_firmware
from hiltest.virtual.board.k64f import VirtualK64F

FLASH_BYTES = 1 << 20


@pytest.fixture
def probe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, require_module: Callable[[str], None]) -> type[Any]:
    """The only probe that pyOCD finds, with a halted board behind it whose flash has something else in it."""
    require_module("pyocd")
    from pyocd.probe import aggregator
    from tests.flashing.virtual_probe import VirtualProbe

    machine = VirtualK64F(default_firmware())
    machine.boot()
    machine.processor.memory.write(0, bytes(FLASH_BYTES))
    monkeypatch.setattr(VirtualProbe, "machine", machine, raising=False)
    monkeypatch.setattr(aggregator, "PROBE_CLASSES", {"virtual": VirtualProbe})
    monkeypatch.setenv("HILTEST_ROOT", str(tmp_path / "machine"))
    UsbTree(tmp_path / "machine")
    monkeypatch.chdir(tmp_path)
    # The table of registers, a file that pyOCD opens for every target and leaves open; nobody reads it.
    monkeypatch.setattr("pyocd.debug.svd.loader.SVDFile.from_builtin", staticmethod(lambda _name: None))
    return VirtualProbe


@pytest.fixture
def app(tmp_path: Path) -> Path:
    """A firmware of a few pages, whose bytes are no two alike."""
    content = bytearray(binary(size=0x2100))
    content[0x410:] = random.Random(1).randbytes(0x2100 - 0x410)
    (tmp_path / "app.bin").write_bytes(content)
    return tmp_path / "app.bin"


@pytest.mark.slow
def test_the_flash_algorithm_writes_the_image_and_erases_the_rest(
    probe: type[Any], app: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("flash", str(app), "--probe", "pyocd", "--json") == 0
    answer = checked(capsys.readouterr().out, "hiltest.flash/1")
    assert (answer["by"], answer["serial_number"], answer["volume"]) == ("pyocd", K64F, None)
    content = app.read_bytes()
    flash = probe.machine.processor.memory.read(0, FLASH_BYTES)
    assert flash[: len(content)] == content
    assert flash[len(content) :] == b"\xff" * (FLASH_BYTES - len(content))


@pytest.mark.slow
def test_a_flash_that_does_not_keep_what_is_written_is_found(
    probe: type[Any], app: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from tests.flashing.virtual_probe import Memory

    read = Memory.read_memory_block8

    def worn(memory: Any, addr: int, size: int, **attributes: Any) -> list[int]:
        return [
            item & ~0x10 if addr + at == 0x4AA else item
            for at, item in enumerate(read(memory, addr, size, **attributes))
        ]

    was = app.read_bytes()[0x4AA]
    assert was & 0x10
    monkeypatch.setattr(Memory, "read_memory_block8", worn)
    assert run("flash", str(app), "--probe", "pyocd") == 20
    assert f"the flash has 0x{was & ~0x10:02x} at 0x000004aa where 0x{was:02x} was written" in capsys.readouterr().err


def test_what_pyocd_cannot_do_is_said(
    probe: type[Any], app: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(probe, "read_ap", lambda _probe, _addr, now=True: 0 if now else lambda: 0)
    assert run("flash", str(app), "--probe", "pyocd") == 20
    assert "pyOCD cannot program the board: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("probes", "code", "message"), [(0, 20, "no FRDM-K64F is plugged in"), (2, 4, "2 boards match")]
)
def test_there_must_be_one_probe(
    probes: int,
    code: int,
    message: str,
    probe: type[Any],
    app: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(probe, "get_all_connected_probes", classmethod(lambda cls, *_: [cls() for _ in range(probes)]))
    assert run("flash", str(app), "--probe", "pyocd") == code
    assert message in capsys.readouterr().err


def test_a_board_whose_probe_may_not_be_used_leads_to_the_udev_rules(
    probe: type[Any], app: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    UsbTree(tmp_path / "with a board").plug_in()
    monkeypatch.setenv("HILTEST_ROOT", str(tmp_path / "with a board"))
    monkeypatch.setattr("pyocd.probe.aggregator.PROBE_CLASSES", {})
    assert run("flash", str(app), "--probe", "pyocd") == 20
    assert f"pyOCD sees no probe of board {K64F}: install the udev rules" in capsys.readouterr().err


def test_without_pyocd_the_extra_is_named(
    app: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HILTEST_ROOT", str(tmp_path / "machine"))
    UsbTree(tmp_path / "machine")
    for name in [name for name in sys.modules if name.partition(".")[0] == "pyocd"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyocd", None)
    assert run("flash", str(app), "--probe", "pyocd") == 4
    assert "pip install 'hiltest[bench]'" in capsys.readouterr().err
