"""Method `quadric`: attribute quadrics down to a number of triangles, and a fit to the input."""
