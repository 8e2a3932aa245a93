"""Method `seams`: a triangle count for meshes with corner attributes.

Corner attributes are texture coordinates, materials, parts and corner normals. Vertices that a file
duplicates along texture seams or between materials or parts are joined and move together. Each joined vertex
keeps separate texture coordinates, colour and normal for every chart. These attributes are part of the error.

After welding by position, the result has no hole, non-manifold edge or duplicate triangle that the input does
not have. No triangle flips in the image, no texture coordinate leaves its chart, and seams stay within
`max_seam_drift`. The end of a seam inside a chart moves like other vertices; several seams that end in a pole
are merged. Materials, parts and images are preserved, the images byte for byte.

The method accepts any mesh; triangles around contacts that cannot be joined stay unchanged. Locked vertices
and their duplicates keep their positions.

References
----------
Feng, Ni and Luo, "Improved surface simplification with multi-attributes", Computer Technology and Development
22(4), 2012. Quadrics and wedges follow Hoppe, "New quadric metric for simplifying meshes with appearance
attributes", 1999.
"""
