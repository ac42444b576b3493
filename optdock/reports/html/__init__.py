"""Reports as one HTML file, which require the extra `report`."""

from optdock.reports.html.comparison_chapter import comparison_chapter
from optdock.reports.html.drive_chapters import log_chapter, run_chapter
from optdock.reports.html.figures import check_bokeh
from optdock.reports.html.html_report import read_chapters, save_report
from optdock.reports.html.plan_chapter import plan_chapter

__all__ = [
    "check_bokeh",
    "comparison_chapter",
    "log_chapter",
    "plan_chapter",
    "read_chapters",
    "run_chapter",
    "save_report",
]
