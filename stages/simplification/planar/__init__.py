"""Method `planar`: near-planar patches, each triangulated anew within its border; for walls and floors.

Patches grow over the surface while normals stay alike (see `scanloom.planar_patches`), the borders between
them are traced and straightened, and each patch is triangulated anew. Every vertex of the result is a vertex
of the input, so that all it carries stays with it; vertices stay where they are or vanish, and triangles
around locked ones stay. The bounds hold for every point and its counterpart on the other surface, colour and
place together, by construction.

They grow greedily, and looser bounds would now and then leave more triangles than tighter ones, which hold as
well: so several are tried (`tighter.py`), and the one that leaves fewest is taken.

It takes any mesh, and keeps it as it is where triangles meet that cannot be joined. Materials and parts are
borders of patches, and stay; an image does not, as it has no place on other triangles. No edge collapses:
there is no importance, no record, and no number of triangles to go down to.

References
----------
Chen and Qin, "3-D surface reduction new algorithm". `kernels/src/planar/mod.rs` says why the bounds hold.
"""
