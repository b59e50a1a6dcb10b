"""Programs that others wrote for the FRDM-K64F do what their README says, on the stock files."""

from __future__ import annotations

import pytest

from .foreign import PROGRAMS, Program, run

pytestmark = pytest.mark.slow  # seconds of virtual time, and what is not waiting takes as long


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_a_program_of_others_does_what_its_readme_says(program: Program) -> None:
    assert run(program).wrong == ()
