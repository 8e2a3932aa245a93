"""Method `jia01`: bounds on accumulated shape and texture changes.

Edges longer than the resolution L are split first. The others then collapse in the order of the change
accumulated around them. The edge's midpoint is projected onto the planes of the adjacent triangles, in the
space of position and colour. The new vertex is the mean of the projections.

Both changes are sums over collapses. The texture change measures contrast, not error, which is why the
default of its bound `max_color` looks large. With a triangle count, only bounds that are given limit the
simplification. The other defaults only affect the order of collapses, and the resolution also splits.

The paper leaves L to the user, and S_max is 0.1 L. By default, L is a little longer than the edges of the
input (`scanloom.stages.simplification.jia01.resolution`), so that splits and the limit on lengths even out
the vertices. S_max does not follow that L, because 0.1 L is below the noise of scans.

The paper measures shape change at vertices only, so a long triangle may deviate between them. It also
accumulates changes per edge, although a point may move to the triangle of another edge. Unless `paper_rule`
is set, both are corrected. The shape change includes the distance of the surfaces where old and new edges
cross. In folded neighbourhoods, it includes the movement of the end points instead. Each new edge starts from
the maximum sum around it. In all our measurements, the distance between input and result then stayed below
`max_shape`.

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
