"""Depth estimation from stereo pairs and from posed single views."""
