"""Machines and boards that a doctor looks at."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.usb_tree import UsbTree

from hiltest.doctor.check import Check
from hiltest.rig.bench_files import shipped

from ..boards.conftest import pty_board, real_rig, rig, rig_without_shield  # noqa: F401  # fixtures

NOBODY = 65_534


@pytest.fixture
def tree(tmp_path: Path) -> UsbTree:
    return UsbTree(tmp_path / "machine")


@pytest.fixture
def by_name() -> Callable[[Iterable[Check]], dict[str, Check]]:
    """Return a function that puts checks under their names, in their order."""

    def named(checks: Iterable[Check]) -> dict[str, Check]:
        results = [*checks]
        assert len({entry.name for entry in results}) == len(results)
        return {entry.name: entry for entry in results}

    return named


@pytest.fixture
def as_nobody(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Be nobody for a test, where the tests' user may be."""
    if os.geteuid() != 0:
        yield
        return
    place = shipped()  # which nobody could not look for, where hiltest is installed in a folder of root's
    monkeypatch.setattr("hiltest.doctor.host_checks.shipped", lambda: place)
    groups = os.getgroups()
    os.setgroups([])
    os.setegid(NOBODY)
    os.seteuid(NOBODY)
    yield
    os.seteuid(0)
    os.setegid(0)
    os.setgroups(groups)


@contextmanager
def held_by_a_process(path: Path | str) -> Iterator[int]:
    """Have another process hold a terminal open; give its number."""
    holds = "import os, sys; os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); print(flush=True); sys.stdin.read()"
    command = [sys.executable, "-I", "-S", "-c", holds, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdin is not None
        assert holder.stdout is not None
        holder.stdout.readline()
        yield holder.pid
        holder.stdin.close()
