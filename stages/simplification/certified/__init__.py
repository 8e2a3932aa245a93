"""Method `certified`: proven bounds on distance and colour at every point.

Edges collapse in the order of method `quadric`, while the input's vertices stay within the bounds. The bounds
are then proven for all points in between. Where the proof fails, the responsible collapses are undone and the
limits of nearby vertices are tightened. Simplification continues from there, and changed triangles are proven
again. With a triangle count, simplification stops at the count or at the bounds, whichever comes first.

Every point of either surface is within `max_shape` of the other surface. Its colour is within `max_color` of
the colour at every nearest point there. The bounds hold for the exact coordinates, and for 32-bit floats in a
file. For this and for single-precision searches they include a slack: 2⁻²¹ of the largest coordinate and 2⁻²⁰
of the bounding box's diagonal. The smallest provable distance is twice the slack; a smaller `max_shape` is
raised to it, which is reported as an unmet requirement. A smaller `max_color` than half a level is raised to
that. Where sheets of different colours touch, a point has nearest points of both colours and no colour bound
may be provable. Triangles there stay unchanged. Without a bound on colour, unchanged triangles need no proof.

For meshes with texture coordinates, materials, parts or corner normals, edges collapse as in method `seams`.
Only the distance is proven then. `max_color` is checked at samples as dense as the texels, and reported as
measured (`corner_attribute_run.py`).

Importance divides the bounds around a vertex, and so must be at least 1. With `partial`, Ctrl-C still proves
the deviation of the mesh simplified so far.

References
----------
Garland and Heckbert, "Surface simplification using quadric error metrics", 1997, and Hoppe, "New quadric
metric for simplifying meshes with appearance attributes", 1999: order and placement. Ciampalini, Cignoni,
Montani and Scopigno, "Multiresolution decimation based on global error", 1997: tracking the input's vertices.
"""
