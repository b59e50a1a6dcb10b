"""Programs that others wrote for the FRDM-K64F do what their README says, on the stock files."""

from __future__ import annotations

import os

import pytest

from .foreign import PROGRAMS, Program, run

NAMES = {
    "riot_hello", "riot_hwrng", "riot_timer", "riot_ztimer_msg", "sdk_adc16_polling", "sdk_crc",
    "sdk_edma_memory_to_memory", "sdk_flash_pflash", "sdk_ftm_timer", "sdk_lptmr", "sdk_rnga_random",
}  # fmt: skip


@pytest.mark.parametrize("program", [each for each in PROGRAMS if each.name in NAMES], ids=lambda each: each.name)
def test_a_program_of_others_does_what_its_readme_says(program: Program) -> None:
    if not program.path.is_file():
        assert not os.environ.get("HILTEST_REQUIRE_TOOLS"), (
            f"{program.path} is missing, and HILTEST_REQUIRE_TOOLS is set"
        )
        pytest.skip(f"{program.path} is not there")
    assert run(program).wrong == ()
