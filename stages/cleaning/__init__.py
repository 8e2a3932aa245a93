"""Cleaning: one kind of defect a module, `clean` puts them right in turn."""
