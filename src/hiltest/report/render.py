"""Write every report of a run."""

from __future__ import annotations

from pathlib import Path

from hiltest.record.files import write_atomically
from hiltest.record.run import Run
from hiltest.report.html import html_report
from hiltest.report.markdown import markdown_report

HTML_FILE, MARKDOWN_FILE = "report.html", "report.md"


def write_reports(run: Run, folder: Path) -> str:
    """Write ``report.html`` and ``report.md`` beside ``run.json``; return the text of the latter."""
    write_atomically(folder / HTML_FILE, html_report(run))
    page = markdown_report(run)
    write_atomically(folder / MARKDOWN_FILE, page)
    return page
