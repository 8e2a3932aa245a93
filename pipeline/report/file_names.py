"""File names of the report and the page in the output folder."""

REPORT, PAGE = "report.json", "report.html"
