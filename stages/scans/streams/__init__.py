"""Image streams shared by layouts and recordings: stereo rigs and timestamped streams."""
