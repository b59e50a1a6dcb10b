"""Totals of tests that count the outcomes of many inputs; a plugin prints them at the end, over all processes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import pytest

_TOTALS = pytest.StashKey[dict[str, Counter[str]]]()


def session_totals(config: pytest.Config, title: str) -> Counter[str]:
    """Return the counter with a title, one for the whole session."""
    return config.stash.setdefault(_TOTALS, {}).setdefault(title, Counter())


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Send the totals, if this process is a worker of pytest-xdist."""
    if (output := getattr(session.config, "workeroutput", None)) is not None:
        output["totals"] = {title: dict(counted) for title, counted in session.config.stash.get(_TOTALS, {}).items()}


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: object) -> None:
    """Add the totals that a worker has sent; a worker that crashed has sent none."""
    sent: Mapping[str, Mapping[str, int]] = getattr(node, "workeroutput", {}).get("totals", {})
    for title, counted in sent.items():
        session_totals(node.config, title).update(counted)  # type: ignore[attr-defined]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print all totals."""
    for title, counted in config.stash.get(_TOTALS, {}).items():
        terminalreporter.write_line(f"{title}: {dict(sorted(counted.items()))}")
