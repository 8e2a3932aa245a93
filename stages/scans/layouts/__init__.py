"""Readers of scan folders, one module per layout."""
