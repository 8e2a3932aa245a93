"""Adjustment of poses and of the colour camera to matched keypoints and measured depth."""
