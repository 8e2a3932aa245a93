"""Commands, one per file; `scanloom.cli.command_table` lists them."""
