"""TSDF fusion of posed depth maps into a mesh."""
