"""Recordings of RealSense cameras."""
