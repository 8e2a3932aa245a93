"""Recordings of ROS 1, ROS 2 and RealSense, and `.sens` files."""
