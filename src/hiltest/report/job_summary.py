"""Output for GitHub Actions: the summary of a job, and one annotation if it is red.

This output decides nothing: a failure to write is reported, and the verdict stays the same.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path

from hiltest.report.markdown_text import cut
from hiltest.report.terminal import shown_path
from hiltest.run_record.run import Verdict

VARIABLE = "GITHUB_STEP_SUMMARY"
MOST_BYTES = 1000 * 1024
"""GitHub drops a summary above 1 024 KiB per step and fails the step; it rejects some just below the limit."""


def remove_job_summary(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return the environment for a run that is part of another run, which writes the summary of both."""
    return {name: value for name, value in environment.items() if name != VARIABLE}


def append_to_job_summary(page: str, whole_is: Path, environment: Mapping[str, str] = os.environ) -> str:
    """Append a page of Markdown to the summary of the step, as far as there is room for it.

    Parameters
    ----------
    whole_is
        File that contains the whole page.
    environment
        Environment with the summary's file in ``GITHUB_STEP_SUMMARY``; without it nothing is done.

    Returns
    -------
    str
        A warning that the page was cut or could not be written; empty if neither is the case.
    """
    name = environment.get(VARIABLE)
    if not name:
        return ""
    try:
        # A pipe of that name may have no reader: O_NONBLOCK makes that an error instead of an endless wait.
        file = os.open(name, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK, 0o644)
    except (OSError, ValueError) as error:
        return _write_warning(name, error)
    try:
        return _append(file, name, page, shown_path(whole_is))
    except OSError as error:
        return _write_warning(name, error)
    finally:
        os.close(file)


def annotation(verdict: Verdict, environment: Mapping[str, str] = os.environ) -> str:
    """Return GitHub's annotation for a run that did not pass; empty for others, and outside of GitHub Actions."""
    if verdict.exit_code == 0 or environment.get("GITHUB_ACTIONS") != "true":
        return ""
    title = _escape(f"hiltest: {verdict.outcome}").replace(":", "%3A").replace(",", "%2C")
    return f"::error title={title}::{_escape(verdict.sentence)}\n"


def _append(file: int, name: str, page: str, whole_is: str) -> str:
    existing = os.fstat(file).st_size
    apart = "\n" if existing else ""  # another program may not have ended its last line
    room = MOST_BYTES - existing - len(apart)
    shown = cut(page, room, whole_is)
    if not shown:
        return f"no job summary: {name} has {existing // 1024} KiB already, and its limit is {MOST_BYTES // 1024} KiB"
    remaining = (apart + shown).encode("utf-8", errors="backslashreplace")
    try:
        while remaining:
            remaining = remaining[os.write(file, remaining) :]
    except OSError:
        with contextlib.suppress(OSError):
            os.ftruncate(file, existing)  # half a table would spoil the existing content
        raise
    return "" if shown == page else f"the job summary was cut to {MOST_BYTES // 1024} KiB; {whole_is} is complete"


def _write_warning(name: str, error: Exception) -> str:
    reason = error.strerror if isinstance(error, OSError) else str(error)
    return f"no job summary: cannot write {name}: {reason}"


def _escape(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
