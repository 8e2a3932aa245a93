"""What programs may rely on in JSON: one number for report.json and all that `--json` prints, errors too.

Every such object begins with `"schema": N`. N is raised when a name changes its meaning or disappears; names
may be added at any time. 1 were the reports before every thing had one word.
"""

SCHEMA = 2
