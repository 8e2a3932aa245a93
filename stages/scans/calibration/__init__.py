"""Cameras: calibration files, and what stands in for them."""
