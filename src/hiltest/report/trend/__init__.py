"""Each measurement over the runs of a folder: `read_folder`, `trend_of` them, and a page, a table or JSON of it."""

from hiltest.report.trend.folder import Skipped, read_folder
from hiltest.report.trend.outputs import trend_page
from hiltest.report.trend.series import RunEntry, Trend, trend_of

__all__ = ["RunEntry", "Skipped", "Trend", "read_folder", "trend_of", "trend_page"]
