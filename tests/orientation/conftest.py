"""The attitude filter in both forms."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from functools import partial

import pytest

from hiltest.orientation.attitude_filter import AttitudeFilter

from .filters import FirmwareFilter, build


@pytest.fixture(scope="session")
def attitude_filter_library(
    require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory
) -> ctypes.CDLL:
    return build(require_tool("gcc"), tmp_path_factory.mktemp("attitude_filter"))


@pytest.fixture(scope="session", params=["reference", "firmware"])
def either_filter(request: pytest.FixtureRequest) -> Callable[..., object]:
    """Return what makes an attitude filter of one of the two, from a bias."""
    if request.param == "reference":
        return lambda bias_rad_s=(0.0, 0.0, 0.0): AttitudeFilter(bias_rad_s)
    return partial(FirmwareFilter, request.getfixturevalue("attitude_filter_library"))


@pytest.fixture(scope="session")
def rounding_deg(either_filter: Callable[..., object]) -> float:
    """Return the largest angle that roundings of a thousand steps add up to in this form.

    A step rounds a quaternion of norm 1 by some 1e-7 in float32, which is twice that as an angle; at worst a thousand
    roundings have one direction.
    """
    float32 = isinstance(either_filter, partial)
    return math.degrees(1000 * 2 * 1.2e-7) if float32 else 1e-6
