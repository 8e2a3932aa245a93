"""Method `certified`: as far as bounds on distance and colour are proven for every point of both surfaces.

It collapses as `quadric` does, as long as the vertices of the input stay within the bounds. Then these are
proven for every point between, and where that fails the collapses behind it are taken back, the limits of
the vertices around are tightened, and it goes on from there; what has changed is proven again. With a number
of triangles too, it ends at this number or at the bounds, whichever comes first.

Every point of either surface is within `max_shape` of the other, and its colour within `max_color` of the
colour at every nearest point there. The bounds hold for positions as they are, and as 32-bit floats in a
file: they contain 2⁻²¹ of the largest coordinate and 2⁻²⁰ of the bounding box's diagonal for that, and for
searches in single precision. Twice as much is the least distance that can be proven, and takes the place of
a smaller `max_shape`; half a level takes that of a smaller `max_color`. Bounds need not be provable at all
where sheets of different colours touch, since a point there has nearest points of both colours; triangles
there stay as they are.

Where corners have texture coordinates, materials, parts or normals of their own, collapses are those of
method `seams`, and the distance alone is proven; `max_color` is held at samples as dense as the texels, and
called measured (`along_seams.py`).

Importance divides the bounds around a vertex, and so is at least 1. Ctrl-C with `partial` still proves how
far the mesh is from the input by then.

References
----------
Garland and Heckbert, "Surface simplification using quadric error metrics", 1997, and Hoppe, "New quadric
metric for simplifying meshes with appearance attributes", 1999, for order and placement; Ciampalini,
Cignoni, Montani and Scopigno, "Multiresolution decimation based on global error", 1997, for watching the
input's vertices.
"""
