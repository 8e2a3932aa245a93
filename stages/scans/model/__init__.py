"""Scan in memory: frames, cameras, images, and parallel prefetching."""
