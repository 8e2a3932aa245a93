"""Texturing of meshes: baking from another mesh, texturing from photos, and atlas layout."""
