"""Collapse records, from which every intermediate mesh can be restored."""
