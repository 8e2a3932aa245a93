"""Comparison of meshes and point clouds, with samples or proven bounds."""
