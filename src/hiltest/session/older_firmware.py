"""``--against``: the older of two firmwares, which runs first with the rig, seeds, points and noise of the newer."""

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
from hiltest.processes import run_child
from hiltest.report.job_summary import remove_job_summary
from hiltest.report.terminal import shown_path
from hiltest.run_record.exit_codes import ExitCode
from hiltest.run_record.files import COVERAGE_FILE, RUN_FILE
from hiltest.session.record_folder import remove_runs

if TYPE_CHECKING:
    from hiltest.rig import Rig

UNJUDGED = ("-o", "hil_baseline=")
"""Options of pytest for a run that is itself the base, or part of a comparison, and therefore has no base."""

UNCOVERED = ("-o", "hil_coverage=", "-o", "hil_record=", "-o", "hil_replay=")
"""Options of pytest for a run without coverage and recording."""

_VARIABLE = "HIL_BASELINE"
_OF_ONE_RUN = (_VARIABLE, "HIL_COVERAGE", "HIL_RECORD", "HIL_REPLAY")


@dataclass(frozen=True, slots=True)
class OlderFirmware:
    """The older of two firmwares."""

    elf: str
    """File as the user named it."""
    options: tuple[str, ...]
    """Options of pytest, the same as for the newer firmware."""
    folder: Path
    """Folder of its record."""

    @property
    def record(self) -> str:
        """File of its record, relative to the current folder if possible."""
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
        """Run the suites with it, in a process of its own, since pytest keeps state that would affect a second run.

        Returns
        -------
        str
            Last line of output, which is its verdict.

        Raises
        ------
        KeyboardInterrupt
            If the run was interrupted.
        ConfigError
            If the run was refused.
        """
        options = older_options(self.options, self.elf)
        done = run_command(f"--out={self.folder}", "--", *options, folder=self.folder)
        last_line = last_words(done.stdout or done.stderr)
        if done.returncode == pytest.ExitCode.INTERRUPTED:
            raise KeyboardInterrupt(f"{self.elf}: {last_line}")
        if done.returncode == pytest.ExitCode.USAGE_ERROR:
            raise ConfigError(f"{self.elf}: {last_words(done.stderr or done.stdout).removeprefix('ERROR: ')}")
        return last_line


def older_options(options: Sequence[str], firmware: str) -> list[str]:
    """Return pytest's options for the older firmware: those of the newer one, except ELF, label, base and coverage."""
    return [*options, f"--hil-firmware={firmware}", "--hil-label=", *UNJUDGED, *UNCOVERED]


def coverage_in(folder: Path, *, covers: bool) -> list[str]:
    """Return the option of ``hiltest run`` that writes the coverage into a folder, if it is wanted."""
    return [f"--coverage={folder / COVERAGE_FILE}"] if covers else []


def run_command(
    *arguments: str, folder: Path, cwd: Path | None = None, environment: Mapping[str, str] = os.environ
) -> subprocess.CompletedProcess[str]:
    """Run ``hiltest run`` without a base, so that its record replaces the one in a folder; 24 if it was killed."""
    remove_runs(folder)  # the record of an earlier command must not pass for this one's
    command = [sys.executable, "-m", "hiltest", "run", *arguments]
    done = run_child(command, cwd=cwd, environment=_environment(environment))
    if done.returncode < 0:  # a signal ended it
        done.returncode = ExitCode.CUT_SHORT
    return done


def last_words(output: str) -> str:
    """Return the last line of a command's output."""
    words = output.strip().splitlines()
    return words[-1] if words else "no output"


def base_of_environment() -> str | None:
    """Return the base that the environment names; None without one."""
    return os.environ.get(_VARIABLE) or None


def _environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a run within another: without a base, coverage and a job summary."""
    return {name: value for name, value in remove_job_summary(environment).items() if name not in _OF_ONE_RUN}
