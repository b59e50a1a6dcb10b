"""``--against``: the older of two firmwares, run first on the rig, seeds, points and noise of the newer."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from hiltest.report.job_summary import without_job_summary
from hiltest.report.record import SEED_FOLDERS
from hiltest.sole_command import remove_run

FOLDER = "against"
"""Of the older firmware's record, in the folder of the newer one's."""

UNJUDGED = ("-o", "hil_baseline=")
"""For pytest: a run that is itself the base, or a part of what is judged, has no base."""

_VARIABLE = "HIL_BASELINE"


def older_options(options: Sequence[str], firmware: str) -> list[str]:
    """Return pytest's options for the older firmware: those of the newer one, but for ELF, label and base."""
    return [*options, f"--hil-firmware={firmware}", "--hil-label=", *UNJUDGED]


def run_older(options: Sequence[str], firmware: str, out: Path) -> subprocess.CompletedProcess[str]:
    """Run the suites with the older firmware, in a process of its own: pytest keeps state that a second run would meet.

    Parameters
    ----------
    options : sequence of str
        For pytest, as the newer firmware has them.
    firmware : str
        ELF file.
    out : Path
        Folder of its record.
    """
    return run_command(f"--out={out}", "--", *older_options(options, firmware), folder=out)


def run_command(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run ``hiltest run`` without a base, so that its record is in a folder and what was there before is not."""
    for each in (*folder.glob(SEED_FOLDERS), folder):
        remove_run(each)  # what an earlier command left must not pass for this one's
    command = [sys.executable, "-m", "hiltest", "run", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=_environment(os.environ))


def last_words(output: str) -> str:
    """Return the last line that a command wrote."""
    words = output.strip().splitlines()
    return words[-1] if words else "no output"


def base_of_environment(environment: Mapping[str, str] = os.environ) -> str | None:
    """Return the base that the environment names, None without one."""
    return environment.get(_VARIABLE) or None


def _environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return what a run that is part of another has: neither a base nor a job's summary of its own."""
    return {name: value for name, value in without_job_summary(environment).items() if name != _VARIABLE}
