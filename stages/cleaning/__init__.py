"""Mesh cleaning: one module per kind of defect.

`clean` runs all of them in turn.
"""
