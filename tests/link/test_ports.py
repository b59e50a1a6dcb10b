"""A port that cannot be opened says why, and what to do."""

from __future__ import annotations

import os
import tty

import pytest

from hiltest.errors import BenchError, ConfigError, PortNotFoundError, PortRefusedError
from hiltest.link.ports import list_ports, open_port


def test_a_port_that_does_not_exist_is_named_with_those_that_do() -> None:
    with pytest.raises(PortNotFoundError) as caught:
        open_port("/dev/ttyNOSUCH7")
    assert caught.value.wanted == "/dev/ttyNOSUCH7"
    assert caught.value.seen == list_ports()
    assert "--hil-port" in str(caught.value)


def test_an_unknown_scheme_is_a_configuration_error() -> None:
    with pytest.raises(ConfigError, match="nosuch://x"):
        open_port("nosuch://x")


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
        with pytest.raises(PortRefusedError, match="another program has it open"):
            open_port(os.ttyname(slave))
    finally:
        first.close()
        os.close(master)
        os.close(slave)
