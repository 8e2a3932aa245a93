"""Inspection of a scan before processing: contents, quality and suspicious input."""
