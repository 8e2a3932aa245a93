"""Method `planar`: near-planar patches, each retriangulated within its border.

It suits walls, floors and machined parts.

Patches grow over the surface while normals agree (see `scanloom.planar_patches`). The borders between patches
are traced and straightened, and each patch is retriangulated. Every vertex of the result is an unmoved vertex
of the input and keeps its attributes. Triangles around locked vertices stay. The bounds hold by construction:
every point has a counterpart on the other surface, within the distance and the colour bound at once.

Patches grow greedily, so looser bounds sometimes leave more triangles than tighter ones. Several tighter
bounds are therefore tried (`tighter.py`), and the result with the fewest triangles is taken.

The method accepts any mesh; triangles around non-manifold elements stay unchanged. Borders between materials
and parts are patch borders. Images are lost, because texture coordinates do not fit the new triangles. No
edge collapses, so importance, records and triangle counts are not supported.

References
----------
Chen and Qin, "3-D surface reduction new algorithm". `kernels/src/planar/mod.rs` explains why the bounds hold.
"""
