"""The layout of COLMAP folders, and its model files."""
