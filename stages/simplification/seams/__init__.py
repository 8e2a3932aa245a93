"""Method `seams`: models with texture, materials and parts, along their seams (Feng, Ni and Luo 2012)."""
