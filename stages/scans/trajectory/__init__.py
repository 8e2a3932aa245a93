"""Trajectories: trajectory files, files of one pose each, and matching of poses to frames."""
