"""``--against``: the older of two firmwares, run first on the rig, seeds, points and noise of the newer."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from hiltest.errors import ConfigError
from hiltest.record.files import COVERAGE_FILE, RUN_FILE, SEED_FOLDERS
from hiltest.report.job_summary import without_job_summary
from hiltest.report.terminal import shown_path
from hiltest.runs.folders import remove_run

if TYPE_CHECKING:
    from hiltest.rig import Rig

UNJUDGED = ("-o", "hil_baseline=")
"""For pytest: a run that is itself the base, or a part of a comparison, has no base."""

UNCOVERED = ("-o", "hil_coverage=", "-o", "hil_record=", "-o", "hil_replay=")
"""For pytest: a run whose coverage and recording are not asked for."""

_VARIABLE = "HIL_BASELINE"
_OF_ONE_RUN = (_VARIABLE, "HIL_COVERAGE", "HIL_RECORD", "HIL_REPLAY")


@dataclass(frozen=True, slots=True)
class OlderFirmware:
    """The older of two firmwares."""

    elf: str
    """File as it was named."""
    options: tuple[str, ...]
    """For pytest, as the newer firmware has them."""
    folder: Path
    """Folder of its record."""

    @property
    def record(self) -> str:
        """Its record, as one would type it here."""
        return shown_path(self.folder / RUN_FILE)

    def check(self, rig: Rig) -> None:
        """Check the file before anything runs.

        Raises
        ------
        ConfigError
            If it cannot be loaded into the rig's virtual board, or the rig has none.
        """
        from hiltest.boards import VirtualBench

        VirtualBench(rig, firmware=Path(self.elf))

    def run(self) -> str:
        """Run the suites with it, in a process of its own: pytest keeps state that a second run would meet.

        Returns
        -------
        str
            The last line that it wrote: its verdict.

        Raises
        ------
        KeyboardInterrupt
            If it was interrupted.
        ConfigError
            If it was refused.
        """
        options = older_options(self.options, self.elf)
        done = run_command(f"--out={self.folder}", "--", *options, folder=self.folder)
        said = last_words(done.stdout or done.stderr)
        if done.returncode == pytest.ExitCode.INTERRUPTED:
            raise KeyboardInterrupt(f"{self.elf}: {said}")
        if done.returncode == pytest.ExitCode.USAGE_ERROR:
            raise ConfigError(f"{self.elf}: {last_words(done.stderr or done.stdout).removeprefix('ERROR: ')}")
        return said


def older_options(options: Sequence[str], firmware: str) -> list[str]:
    """Return pytest's options for the older firmware: those of the newer one, but for ELF, label, base and coverage."""
    return [*options, f"--hil-firmware={firmware}", "--hil-label=", *UNJUDGED, *UNCOVERED]


def coverage_in(folder: Path, *, covers: bool) -> list[str]:
    """Return the option of ``hiltest run`` that leaves the coverage in a folder, if it is to."""
    return [f"--coverage={folder / COVERAGE_FILE}"] if covers else []


def run_command(
    *arguments: str, folder: Path, here: Path | None = None, environment: Mapping[str, str] = os.environ
) -> subprocess.CompletedProcess[str]:
    """Run ``hiltest run`` without a base, so that its record replaces the one in a folder."""
    remove_runs(folder)  # what an earlier command left must not pass for this one's
    command = [sys.executable, "-m", "hiltest", "run", *arguments]
    return subprocess.run(
        command, cwd=here, capture_output=True, text=True, check=False, env=_environment(environment)
    )  # fmt: skip


def remove_runs(folder: Path) -> None:
    """Remove the run or the campaign that an earlier command left in a folder."""
    for each in (*folder.glob(SEED_FOLDERS), folder):
        remove_run(each)


def last_words(output: str) -> str:
    """Return the last line that a command wrote."""
    words = output.strip().splitlines()
    return words[-1] if words else "no output"


def base_of_environment(environment: Mapping[str, str] = os.environ) -> str | None:
    """Return the base that the environment names, None without one."""
    return environment.get(_VARIABLE) or None


def _environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a run within another: without a base, coverage and a job's summary of its own."""
    return {name: value for name, value in without_job_summary(environment).items() if name not in _OF_ONE_RUN}
