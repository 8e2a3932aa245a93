"""Files from outside, read without trusting them: meshes, calibrations, trajectories."""
