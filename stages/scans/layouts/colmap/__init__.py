"""COLMAP workspaces and model files."""
