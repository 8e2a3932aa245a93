"""Layouts of the KITTI data sets, their calibration and navigation files."""
