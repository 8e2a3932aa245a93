"""Mesh files, read by code that no file can take down, and written whole."""
