"""The gate set of tests: all but those marked ``full``.

The gate is what every change waits for; what takes longest and gates little is run by the full set alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pytest

MARKER = "full"
_NAMED_AT_MOST = 3


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Tests that this session would have run, were it of the full set.

    Attributes
    ----------
    tests : tuple of str
        Node ids.
    how : str
        The option that brings them back.
    """

    tests: tuple[str, ...] = ()
    how: str = ""

    def describe(self) -> list[str]:
        """Return what to say of them once tests are collected."""
        if not self.tests:
            return []
        names = [each.rpartition("/")[2] for each in self.tests]
        more = len(names) - _NAMED_AT_MOST
        listed = ", ".join(names[:_NAMED_AT_MOST]) + (f" and {more} more" if more > 0 else "")
        count = f"{len(names)} test{'s' * (len(names) != 1)}"
        return [f"gate set: {count} of the full set left out, {self.how} runs them: {listed}"]

    def check_that_some_are_left(self, items: Sequence[pytest.Item]) -> None:
        """Refuse to run nothing: whoever asked for just these must know why they do not run.

        Raises
        ------
        pytest.UsageError
            If `items` is empty.
        """
        if self.tests and not items:
            raise pytest.UsageError(f"nothing to run in the {self.describe()[0]}")


def leave_out_full(config: pytest.Config, items: list[pytest.Item], candidates: Sequence[pytest.Item]) -> LeftOut:
    """Deselect the tests of the full set.

    Parameters
    ----------
    config : pytest.Config
    items : list of pytest.Item
        All that are to run; changed in place.
    candidates : sequence of pytest.Item
        Those that have to do with hiltest. Another project's mark of the same name is its own affair.

    Returns
    -------
    LeftOut
        Those that were.
    """
    full = [item for item in candidates if item.get_closest_marker(MARKER) is not None]
    how = "--suite full" if config.pluginmanager.has_plugin("hiltest-run") else "--hil-suite=full"
    left_out = LeftOut(tuple(item.nodeid for item in full), how)
    if full:
        config.hook.pytest_deselected(items=full)
        items[:] = [item for item in items if item not in full]
    return left_out
