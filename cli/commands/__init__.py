"""The commands, one a file; `scanloom.cli.app` has the table of them."""
