"""What all tests share."""

from __future__ import annotations

import os
import shutil
import signal
import threading
from collections.abc import Callable
from importlib.util import find_spec
from typing import NoReturn

import pytest
from hypothesis import settings

pytest_plugins = ["pytester"]

# A shell ignores Ctrl-C for what it starts in the background, and every process that is started from there inherits
# that, those too which tests end with it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)

# How long an example takes is the machine's affair, which may be busy.
settings.register_profile("hiltest", deadline=None)
settings.load_profile("hiltest")

# Runs that tests make have no part in the job that runs the tests, nor its check an annotation of them.
for name in ("GITHUB_STEP_SUMMARY", "GITHUB_ACTIONS"):
    os.environ.pop(name, None)


@pytest.fixture(scope="session")
def require_tool() -> Callable[[str], str]:
    """Return a function that finds a program, and skips the test when it is missing.

    With HILTEST_REQUIRE_TOOLS set, as where every tool is meant to be installed, it fails instead.
    """

    def find(name: str) -> str:
        path = shutil.which(name)
        if path is None:
            _missing(f"{name} is not installed")
        return path

    return find


@pytest.fixture(scope="session")
def require_module() -> Callable[[str], None]:
    """Return a function that skips the test when a package cannot be imported, or fails as `require_tool` does."""

    def check(name: str) -> None:
        if find_spec(name) is None:
            _missing(f"the package {name} is not installed")

    return check


def _missing(reason: str) -> NoReturn:
    if os.environ.get("HILTEST_REQUIRE_TOOLS"):
        pytest.fail(f"{reason}, and HILTEST_REQUIRE_TOOLS is set", pytrace=False)
    pytest.skip(reason)
