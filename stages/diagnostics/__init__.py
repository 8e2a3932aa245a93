"""Diagnostics: what is wrong, odd or not reached, as values with a stable code."""
