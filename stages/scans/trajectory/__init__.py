"""Poses: trajectory files, files of one pose each, and times."""
