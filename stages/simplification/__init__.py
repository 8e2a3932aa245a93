"""Simplification: one folder a method, and what all methods share."""
