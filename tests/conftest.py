"""What all tests share."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable

import pytest

pytest_plugins = ["pytester"]


@pytest.fixture(scope="session")
def require_tool() -> Callable[[str], str]:
    """Return a function that finds a program, and skips the test when it is missing.

    With HILTEST_REQUIRE_TOOLS set, as where every tool is meant to be installed, it fails instead.
    """

    def find(name: str) -> str:
        path = shutil.which(name)
        if path is not None:
            return path
        reason = f"{name} is not installed"
        if os.environ.get("HILTEST_REQUIRE_TOOLS"):
            pytest.fail(f"{reason}, and HILTEST_REQUIRE_TOOLS is set", pytrace=False)
        pytest.skip(reason)

    return find
