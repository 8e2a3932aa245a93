"""TUM RGB-D data set: layout, cameras, and association lists."""
