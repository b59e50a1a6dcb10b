"""UART1 to UART5 on ports of their own, and flash that is kept from run to run, of ``hiltest serve``."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import serial
from tests.finished_run import run_module

from .conftest import FLAGS, HERE, START, WALL_LIMIT_S, Serve


@pytest.fixture
def two_ports(tmp_path: Path, require_tool: Callable[[str], str]) -> Path:
    """Build firmware that talks on UART3 and counts its boots in flash."""
    elf = tmp_path / "two_ports.elf"
    sources = [START / "start.S", HERE / "programs" / "two_ports.c"]
    command = [require_tool("arm-none-eabi-gcc"), *FLAGS, *map(str, sources), "-o", str(elf)]
    subprocess.run(command, check=True, timeout=WALL_LIMIT_S)
    return elf


@pytest.mark.parametrize("where", ["", "=uart3", "=tcp:0"], ids=["pty", "link", "tcp"])
def test_a_uart_is_served_where_it_is_asked_for(serve: Serve, two_ports: Path, where: str) -> None:
    stored = two_ports.parent / "flash.bin"
    for boot in (b"1", b"2"):
        served = serve(
            "--firmware", str(two_ports), "--baud", "9600", "--uart", f"3{where}", "--flash-file", str(stored)
        )
        assert served.process.stdout is not None
        name, _, url = served.process.stdout.readline().strip().partition(": ")
        assert name == "uart3"
        if where == "=uart3":
            assert url == "uart3"
            url = str(two_ports.parent / url)
        with serial.serial_for_url(url, timeout=WALL_LIMIT_S) as port:
            port.write(b"x")
            assert port.read(2) == boot + b"x"
        code, answer = served.end()
        assert code == 0
        assert "not modelled" not in answer


@pytest.mark.parametrize("wrong", ["0", "3=tcp:70000", "3="])
def test_a_wrong_port_is_a_wrong_option(wrong: str, tmp_path: Path) -> None:
    done = run_module("hiltest", "serve", "--uart", wrong, folder=tmp_path)
    assert done.returncode == 4
    assert f"--uart {wrong}" in done.stderr
