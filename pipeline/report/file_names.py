"""Names of the documents in the output folder."""

REPORT, PAGE = "report.json", "report.html"
