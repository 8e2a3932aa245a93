"""Streams of images that layouts and recordings share: stereo rigs, and streams with clocks."""
