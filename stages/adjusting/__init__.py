"""Adjustment: one colour camera and better poses, by points that several frames show and measure."""
