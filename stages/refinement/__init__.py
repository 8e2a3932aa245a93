"""Refinement of a fused mesh: the surface of the scene without the noise of the sensor."""
