"""Diagnostics: warnings, errors and unmet requirements as values with a stable code."""
