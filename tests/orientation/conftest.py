"""The fusion filter in both forms."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial

import pytest

from .filters import FilterMaker, Firmware, Reference, build


@pytest.fixture(scope="session")
def fusion_library(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return build(require_tool("gcc"), tmp_path_factory.mktemp("fusion"))


@pytest.fixture(scope="session")
def firmware(fusion_library: ctypes.CDLL) -> FilterMaker:
    """Return what makes a filter of the firmware's, from noise and first attitude."""
    return partial(Firmware, fusion_library)


@pytest.fixture(scope="session", params=["reference", "firmware"])
def either(request: pytest.FixtureRequest) -> FilterMaker:
    """Return what makes a filter of one of the two."""
    return Reference if request.param == "reference" else request.getfixturevalue("firmware")
