"""Registration: views, alignment of two, which pairs to try, and the pose graph."""
