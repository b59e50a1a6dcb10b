"""What a test needs: a board, a rig, or nothing of hiltest."""

from __future__ import annotations

import pytest

_BOARD_FIXTURES = frozenset({"board", "turntable"})
_FIXTURES = _BOARD_FIXTURES | {"measure", "rig"}
_FIXTURE_MODULES = frozenset({"hiltest.fixtures", "hiltest.cycle_benchmarks.hooks"})


def uses_board(item: pytest.Item) -> bool:
    """Say whether a test needs a board: by the marker ``hil`` or by a fixture."""
    return item.get_closest_marker("hil") is not None or bool(_BOARD_FIXTURES & _fixtures_of(item))


def uses_hiltest(item: pytest.Item) -> bool:
    """Say whether a test has anything to do with hiltest."""
    return uses_board(item) or bool(_FIXTURES & _fixtures_of(item))


def uses_rig(item: pytest.Item) -> bool:
    """Say whether a test needs a rig; one that only measures does not."""
    return uses_board(item) or "rig" in _fixtures_of(item)


def is_benchmark(item: pytest.Item) -> bool:
    """Say whether a test shows device cycles in pytest-benchmark, by hiltest's fixture and not another project's."""
    return "benchmark_cycles" in _fixtures_of(item)


def only_shows_cycles(item: pytest.Item) -> bool:
    """Say whether a test shows device cycles and measures nothing that could be judged."""
    return is_benchmark(item) and "measure" not in _fixtures_of(item)


def _fixtures_of(item: pytest.Item) -> set[str]:
    """Return the names of hiltest's own fixtures that a test uses.

    Another project's fixture may be called ``board`` too; its tests are none of our business.
    """
    info = getattr(item, "_fixtureinfo", None)  # pytest has no public way to ask which definition a name resolves to
    if info is None:
        return set()
    used = {name: definitions[-1].func for name, definitions in info.name2fixturedefs.items() if definitions}
    return {name for name, function in used.items() if function.__module__ in _FIXTURE_MODULES}
