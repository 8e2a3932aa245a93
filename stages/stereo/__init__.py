"""What the depth stage is made of: from two images to disparity and how far to trust it."""
