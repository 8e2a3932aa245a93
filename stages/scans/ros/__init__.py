"""Recordings of ROS 1, ROS 2 and RealSense: containers, messages, and what of them becomes a scan."""
