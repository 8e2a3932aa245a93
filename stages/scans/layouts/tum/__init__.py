"""The layout of the TUM RGB-D data set, its cameras and lists."""
