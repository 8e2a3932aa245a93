"""Readers and writers of mesh files; readers survive damaged files, writers replace files atomically."""
