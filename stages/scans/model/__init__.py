"""A scan in memory: frames, cameras, images, and reading ahead."""
