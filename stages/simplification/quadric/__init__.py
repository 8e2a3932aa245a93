"""Method `quadric`: minimum squared error at a given triangle count.

Each collapse is the one that adds the smallest squared distance to the input's triangles, in the space of
position and colour. The new vertex is placed at the minimum. A final fit moves vertices along their normals
and adjusts colours.

The weight of colour is derived from the mesh and the triangle count. On a sample of the mesh, colours
increase the shape error by at most a fifth.

With a ratio of 0.1:

================================  =========  =========  ============  ===========  =======
mesh                              triangles  reduction  RMS distance  colour RMSE  PSNR
================================  =========  =========  ============  ===========  =======
room fused at 2 cm, 6.3 m across    144,611  90.0 %       1.2 mm      2.6 levels   39.8 dB
unit sphere with a satellite map     73,728  90.0 %       0.2 mm      8.7 levels   29.4 dB
================================  =========  =========  ============  ===========  =======

References
----------
Garland and Heckbert, "Surface simplification using quadric error metrics", 1997; Hoppe, "New quadric metric
for simplifying meshes with appearance attributes", 1999. For the fit: Hoppe, DeRose, Duchamp, McDonald and
Stuetzle, "Mesh optimization", 1993.
"""
