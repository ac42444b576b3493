"""Reports as one HTML file, which require the extra `report`."""

from optdock.reports.html.figures import check_bokeh
from optdock.reports.html.html_report import read_chapters, save_report

__all__ = ["check_bokeh", "read_chapters", "save_report"]
