"""Meshes as other programs want them: turned, scaled, small, in their formats."""
