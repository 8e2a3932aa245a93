"""The scanloom command."""
