"""Method `seams`: to a number of triangles, for meshes with texture, materials, parts or normals of corners.

Vertices that a file doubles along texture seams, between materials or parts are one, and move together. Each
keeps texture coordinates, colour and normal for every chart it lies in, which are part of the error.

Welded by position, the result has no hole, no edge of more than two triangles and no triangle upon another
that the input has not. In the image no triangle turns over, no texture coordinate leaves its chart, and
seams stay within `max_seam_drift`. Where a seam ends inside a chart, its tip moves as others do; those that a
pole sends out become one. Materials, parts and images go with it, the images byte for byte.

It takes any mesh, and keeps it as it is where triangles meet that cannot be joined. Locked vertices keep
their positions, and copies of a locked vertex stay too.

References
----------
Feng, Ni and Luo, "Improved surface simplification with multi-attributes", Computer Technology and
Development 22(4), 2012, with the quadrics and wedges of Hoppe, "New quadric metric for simplifying meshes
with appearance attributes", 1999, in place of the paper's.
"""
