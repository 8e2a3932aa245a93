"""Check of names and texts: `python -m tests.language` prints the shares, `--list 40` the first findings."""
