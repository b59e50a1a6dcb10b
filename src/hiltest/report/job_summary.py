"""Show a run where GitHub Actions shows a job: its summary, and one annotation when it is red.

Nothing here decides anything: a failure to write is reported, and the verdict stays.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path

from hiltest.record.run import Verdict
from hiltest.report.markdown_text import cut
from hiltest.report.terminal import shown_path

VARIABLE = "GITHUB_STEP_SUMMARY"
MOST_BYTES = 1000 * 1024
"""A summary above 1 024 KiB a step is dropped as a whole and fails the step; some are refused just below it."""


def without_job_summary(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return the environment for a run that is part of another, which has a summary for both."""
    return {name: value for name, value in environment.items() if name != VARIABLE}


def append_to_job_summary(page: str, whole_is: Path, environment: Mapping[str, str] = os.environ) -> str:
    """Append a page of Markdown to the summary of the step, as much of it as there is room for.

    Parameters
    ----------
    whole_is
        File that has the whole page.
    environment
        Names the summary's file in ``GITHUB_STEP_SUMMARY``; without it nothing is done.

    Returns
    -------
    str
        What a reader has to know: that it was cut or could not be written. Empty when all is well.
    """
    name = environment.get(VARIABLE)
    if not name:
        return ""
    try:
        # A pipe of that name may have no reader: then this is an error, and no wait for ever.
        file = os.open(name, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK, 0o644)
    except (OSError, ValueError) as error:
        return _not_written(name, error)
    try:
        return _append(file, name, page, shown_path(whole_is))
    except OSError as error:
        return _not_written(name, error)
    finally:
        os.close(file)


def annotation(verdict: Verdict, environment: Mapping[str, str] = os.environ) -> str:
    """Return the line that GitHub Actions shows beside the check of a run that did not pass; empty elsewhere."""
    if verdict.exit_code == 0 or environment.get("GITHUB_ACTIONS") != "true":
        return ""
    title = _escaped(f"hiltest: {verdict.outcome}").replace(":", "%3A").replace(",", "%2C")
    return f"::error title={title}::{_escaped(verdict.sentence)}\n"


def _append(file: int, name: str, page: str, whole_is: str) -> str:
    there = os.fstat(file).st_size
    apart = "\n" if there else ""  # what another program wrote before may not have ended its line
    room = MOST_BYTES - there - len(apart)
    kept = cut(page, room, whole_is)
    if not kept:
        return f"no job summary: {name} holds {there // 1024} KiB already, and at most {MOST_BYTES // 1024} are kept"
    left = (apart + kept).encode("utf-8", errors="backslashreplace")
    try:
        while left:
            left = left[os.write(file, left):]
    except OSError:
        with contextlib.suppress(OSError):
            os.ftruncate(file, there)  # half a table would spoil what stands there
        raise
    return "" if kept == page else f"the job summary was cut to {MOST_BYTES // 1024} KiB; {whole_is} has all of it"


def _not_written(name: str, error: Exception) -> str:
    reason = error.strerror if isinstance(error, OSError) else str(error)
    return f"no job summary: cannot write {name}: {reason}"


def _escaped(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
