"""Programs that others wrote for the FRDM-K64F do what their README says, on the stock files."""

from __future__ import annotations

import pytest

from .conftest import ForeignProgram
from .foreign import PROGRAMS, run

pytestmark = pytest.mark.slow  # seconds of virtual time, and what is not waiting takes as long


@pytest.mark.parametrize("name", [each.name for each in PROGRAMS])
def test_a_program_of_others_does_what_its_readme_says(name: str, foreign_program: ForeignProgram) -> None:
    assert run(foreign_program(name)).wrong == ()
