"""Rendering of meshes to images, and choice of viewpoints."""
