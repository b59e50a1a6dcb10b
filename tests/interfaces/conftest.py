"""Packets of every kind and release, whatever is in them, and what others made."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from hypothesis import strategies as st

from hiltest.interfaces.packet_fields import Packet, Sent, sent_fields
from hiltest.interfaces.packets import KINDS, Release

DATA = Path(__file__).parents[3] / "shared" / "data"
KINDS_OF_RELEASES = [(release, kind) for release in Release for kind in release.value]
BITS = {"b": 8, "h": 16, "i": 32}


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Return a function that finds what others made, and skips the test where that is not beside the project."""

    def find(name: str) -> Path:
        path = DATA / name
        if not path.exists():
            if os.environ.get("HILTEST_REQUIRE_TOOLS"):
                pytest.fail(f"{path} is missing, and HILTEST_REQUIRE_TOOLS is set", pytrace=False)
            pytest.skip(f"{path} is missing")
        return path

    return find


def numbers(sent: Sent) -> st.SearchStrategy[int]:
    """Every integer of a form; those often whose bytes are delimiters and escapes."""
    bits = BITS[sent.letter.lower()]
    low, high = (0, 2**bits - 1) if sent.letter.isupper() else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    awkward = [
        value
        for byte in (0x7D, 0x7E, 0x5D, 0x5E, 0xFF)
        if low <= (value := int.from_bytes(bytes([byte] * (bits // 8)), "little")) <= high
    ]
    return st.one_of(st.integers(low, high), st.sampled_from([low, high, *awkward]))


@cache
def packets_of(kind: type[Packet]) -> st.SearchStrategy[Packet]:
    """Every packet of a kind."""
    return st.builds(
        kind,
        **{
            name: st.tuples(*[numbers(sent)] * sent.count) if sent.count else numbers(sent)
            for name, sent in sent_fields(kind)
        },
    )


ANY_PACKET = st.one_of(*map(packets_of, KINDS))
