"""Method `jia01`: within bounds on the changes of shape and texture summed up around each edge.

Long edges are split; then edges collapse in the order of what was summed up around them. A new vertex is the
mean of the projections of the edge's midpoint on the planes of the triangles around, in the space of
position and colour.

Shape and texture changes are sums over collapses. The texture change counts contrast, not error, and so the
default of its bound `max_color` looks large. With a number of triangles, a bound that is not given does not
limit; its default then only helps to say which edges go first.

The paper looks at vertices only, and a long triangle can swing away between its corners; and it adds to each
edge what happens around it, though a point may move on to another edge's triangle. Unless `paper_rule` is
set, the shape change therefore also counts how far the surfaces are apart where old and new edges cross, or
how far the ends move where the neighbourhood is folded; and every new edge starts from the largest sum
around. The largest distance between input and result then stayed below `max_shape` wherever we measured it.

With default bounds:

================================  =========  =========  ============  ===========  =======
mesh                              triangles  reduction  RMS distance  colour RMSE  PSNR
================================  =========  =========  ============  ===========  =======
room fused at 2 cm, 6.3 m across    144,611  68.1 %       1.1 mm      2.5 levels   40.3 dB
unit sphere with a satellite map     73,728  77.6 %       0.4 mm      5.0 levels   34.2 dB
================================  =========  =========  ============  ===========  =======

References
----------
Jia, Liu, Pei, Zhu and Li, "Mesh simplification with texture preservation", Journal of Image and Graphics
6(7), 2001: shape change (1)-(2), texture change (3), placement (4)-(6), order (7).
"""
