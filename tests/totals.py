"""Totals of tests that count what happened to many inputs, printed beside pytest's own lines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import pytest


def printed_totals(config: pytest.Config, title: str) -> Iterator[Counter[str]]:
    """Yield a counter for the tests of a fixture's scope, and print it when they have ended."""
    counted: Counter[str] = Counter()
    yield counted
    with config.pluginmanager.getplugin("capturemanager").global_and_fixture_disabled():
        print(f"\n{title}: {dict(sorted(counted.items()))}")
