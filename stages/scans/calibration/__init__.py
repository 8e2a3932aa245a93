"""Camera calibration: file formats, discovery in scan folders, and defaults."""
