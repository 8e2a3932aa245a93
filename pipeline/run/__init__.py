"""Execution of a run: engine, limits, output folder, report."""
