"""How far two meshes are apart: measured at samples, proven at every point, painted."""
