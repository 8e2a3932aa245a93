"""The commands, one a file; `cli.app` has the table of them."""
