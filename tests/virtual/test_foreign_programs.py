"""Programs that others wrote for the FRDM-K64F do what their README says, on the stock files."""

from __future__ import annotations

import os

import pytest

from .foreign import PROGRAMS, Program, run

pytestmark = pytest.mark.slow  # seconds of virtual time, and what is not waiting takes as long


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda each: each.name)
def test_a_program_of_others_does_what_its_readme_says(program: Program) -> None:
    if not program.path.is_file():
        assert not os.environ.get("HILTEST_REQUIRE_TOOLS"), (
            f"{program.path} is missing, and HILTEST_REQUIRE_TOOLS is set"
        )
        pytest.skip(f"{program.path} is not there")
    assert run(program).wrong == ()
