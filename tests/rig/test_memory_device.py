"""The table of a rig that names variables: what it takes, and what it refuses before any board is there."""

from __future__ import annotations

import json
import tomllib

import pytest
from pydantic import TypeAdapter, ValidationError

from hiltest.rig.memory_device import MemoryDevice, MemoryValue

WHOLE = """
server = "localhost:3333"
at_return_of = "fUpdateMagCalibration10Slice"
[values]
hard_iron = { path = "sfg.MagCal.fV", unit = "uT" }
heading = { path = ["app.heading_rad"], unit = "rad", scale = -1 }
fit_error = { path = "fit_error", unit = "%", type = "float" }
"""


def read(text: str) -> MemoryDevice:
    return TypeAdapter(MemoryDevice).validate_json(json.dumps(tomllib.loads(text)))


def test_a_whole_table_is_read() -> None:
    assert read(WHOLE) == MemoryDevice(
        server="localhost:3333",
        at_return_of="fUpdateMagCalibration10Slice",
        values={
            "hard_iron": MemoryValue("sfg.MagCal.fV", unit="uT"),
            "heading": MemoryValue(("app.heading_rad",), unit="rad", scale=-1.0),
            "fit_error": MemoryValue("fit_error", unit="%", type="float"),
        },
    )


@pytest.mark.parametrize(
    ("server", "address"),
    [
        ("localhost:3333", ("localhost", 3333)),
        ("192.168.1.7:2331", ("192.168.1.7", 2331)),
        ("[::1]:1", ("::1", 1)),
    ],
)
def test_a_server_is_a_host_and_a_port(server: str, address: tuple[str, int]) -> None:
    assert MemoryDevice(server=server, values={"heading": MemoryValue("h", unit="deg")}).address == address


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "has no quantity"),
        ('server = "3333"\n[values]\nheading = { path = "h" }', "is host:port of a GDB server"),
        ('server = "localhost:0"\n[values]\nheading = { path = "h" }', "is host:port of a GDB server"),
        ('server = "localhost:99999"\n[values]\nheading = { path = "h" }', "is host:port of a GDB server"),
        ('[values]\nheading = { unit = "deg" }', "path"),
        ('[values]\nheading = { path = "" }', "names no variable"),
        ("[values]\nheading = { path = [] }", "names no variable"),
        ("[values]\nheading = { path = 5 }", "path"),
        ('[values]\nheading = { path = "h", scale = 0 }', "must not be zero"),
        ('[values]\nheading = { path = "h", scale = nan }', "scale"),
        ('[values]\nheading = { path = "h", units = "deg" }', "units"),
    ],
)
def test_what_cannot_be_is_refused(text: str, reason: str) -> None:
    with pytest.raises(ValidationError, match=reason):
        read(text)
