"""KITTI data sets: layouts, calibration files, and navigation data."""
