"""Schema version of report.json and of all `--json` output, including errors.

Every such object begins with `"schema": N`. N increases when a key is removed or changes its meaning; keys
may be added at any time. Version 1 predates the consistent naming of keys.
"""

SCHEMA = 3
