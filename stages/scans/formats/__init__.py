"""Files that a scan folder is made of: calibrations, trajectories, depth images, models."""
