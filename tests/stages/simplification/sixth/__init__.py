"""Method `cut` for tests of the method table: removes everything above a height."""
