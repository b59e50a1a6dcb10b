"""Machines and boards that a doctor looks at."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from tests.usb_tree import UsbTree

from hiltest.doctor.check import Check

from ..boards.conftest import pty_board, real_rig, rig, rig_without_shield  # noqa: F401  # fixtures


@pytest.fixture
def tree(tmp_path: Path) -> UsbTree:
    return UsbTree(tmp_path / "machine")


@pytest.fixture
def by_name() -> Callable[[Iterable[Check]], dict[str, Check]]:
    """Return a function that puts checks under their names, in their order."""

    def named(checks: Iterable[Check]) -> dict[str, Check]:
        found = [*checks]
        assert len({each.name for each in found}) == len(found)
        return {each.name: each for each in found}

    return named
