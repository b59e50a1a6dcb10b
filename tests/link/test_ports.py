"""A port that cannot be opened says why, and what to do."""

from __future__ import annotations

import os
import tty
from contextlib import closing

import pytest
import serial.tools.list_ports
from serial.tools.list_ports_common import ListPortInfo

from hiltest.errors import BenchError, ConfigError, PortNotFoundError, PortRefusedError
from hiltest.link.ports import list_ports, open_port, place_of


def test_a_port_that_does_not_exist_is_named_with_those_that_do() -> None:
    with pytest.raises(PortNotFoundError) as caught:
        open_port("/dev/ttyNOSUCH7")
    assert caught.value.requested == "/dev/ttyNOSUCH7"
    assert caught.value.available == list_ports()
    assert "--port" in str(caught.value)


@pytest.mark.parametrize("url", ["nosuch://x", "hwgrep://(", "hwgrep://x&n=first"])
def test_a_url_that_pyserial_does_not_understand_is_a_configuration_error(url: str) -> None:
    with pytest.raises(ConfigError) as caught:
        open_port(url)
    assert url in str(caught.value)


def test_a_search_for_a_device_opens_it_or_finds_none(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(PortNotFoundError):
        open_port("hwgrep://no such board")
    master, slave = os.openpty()
    device = ListPortInfo(os.ttyname(slave))
    device.description = "Board under test"
    device.serial_number = "0240000"
    monkeypatch.setattr(serial.tools.list_ports, "comports", lambda _include_links=False: [device])
    assert place_of("hwgrep://under test") == "0240000"
    with closing(open_port("hwgrep://under test")) as port:
        assert port.port == device.device
    os.close(master)
    os.close(slave)


def test_a_refused_connection_is_a_bench_error() -> None:
    # Port 1 of this host: nothing listens there.
    with pytest.raises(BenchError, match=r"socket://127\.0\.0\.1:1"):
        open_port("socket://127.0.0.1:1")


@pytest.mark.skipif(os.name != "posix", reason="exclusive opening is flock, which is POSIX")
def test_a_port_in_use_is_refused() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    first = open_port(os.ttyname(slave))
    try:
        with pytest.raises(PortRefusedError, match="another program uses it"):
            open_port(os.ttyname(slave))
    finally:
        first.close()
        os.close(master)
        os.close(slave)
