"""Readers for scan folders: one module a layout, and nothing else."""
