"""Mesh simplification: one package per method, and the code they share."""
