"""Renderers of a run as HTML, Markdown, terminal text and figures. They decide nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiltest.lazy_exports import when_used

if TYPE_CHECKING:
    from hiltest.report.markdown import markdown_report
    from hiltest.report.render import html_report, write_reports

__all__ = ["html_report", "markdown_report", "write_reports"]

__getattr__ = when_used(
    __name__,
    {
        "html_report": "render",
        "markdown_report": "markdown",
        "write_reports": "render",
    },
)
