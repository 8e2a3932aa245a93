"""A texture for a mesh: baked from the colours of another one, and the atlas it is laid out in."""
