"""Typical calls, right and wrong; only type checkers read this file.

A line with `# error: CODE` must be refused, every other line must pass. See test_types.py.
"""

from pathlib import Path

import numpy as np
import open3d as o3d  # noqa: TID251
import trimesh
from numpy.typing import NDArray
from typing_extensions import assert_type

import scanloom
from scanloom import (
    Camera,
    Mesh,
    MeshLike,
    Scan,
    bake,
    certify,
    clean,
    compare,
    decode,
    depth,
    depth_scan,
    fuse,
    inspect,
    planar_patches,
    read_mesh,
    read_scan,
    register,
    remesh,
    render,
    simplify,
    to_open3d,
    to_open3d_legacy,
    to_trimesh,
    topology,
    viewpoints,
    views_depth,
)

mesh, scan = read_mesh("mesh.ply"), read_scan(Path("folder"))
image = np.zeros((4, 4, 3), np.uint8)

_ = scanloom.simplfy  # error: attr-defined
_ = scanloom.stages.show  # error: attr-defined

# Keywords are the fields of the parameter classes.
fuse(scan)
fuse(scan, voxel_size=0.01, device="CPU:0")
fuse(scan, scanloom.FuseParams(voxel_size=0.01), max_depth=3)
fuse(scan.frames[:10], voxel_size=None)
fuse(scan, voxel_siz=0.01)  # error: call-arg
fuse(scan, voxel_size="1 cm")  # error: arg-type
fuse(scan, min_weight=1.5)  # error: arg-type
fuse(scan, max_jump=None)  # error: arg-type
fuse(scan, scanloom.CleanParams())  # error: arg-type
fuse("folder")  # error: arg-type
clean(mesh, keep_largest=True, progress=lambda done, total: done < total)
clean(mesh, keep_largest="yes")  # error: arg-type
clean(mesh, min_area=1.0)  # error: call-arg
clean(mesh, progress=len)  # error: arg-type
compare(mesh, mesh, samples=100)
compare(mesh, mesh, samples=0.5)  # error: arg-type
certify(mesh, mesh, max_color=3)
certify(mesh, mesh, max_texture=3)  # error: call-arg
bake(mesh, mesh, texel_size=0.01, padding=None)
bake(mesh, mesh, padding=0.5)  # error: arg-type
remesh(mesh, levels=3, confidence=[0.5, 1.0])
remesh(mesh, level=3)  # error: call-arg
register(scan, loops=False)
register(scan, loop=False)  # error: call-arg
depth_scan(scan, min_depth=0.5)
views_depth(scan, partners=4)
views_depth(scan, partner=4)  # error: call-arg
mesh.with_(colors=None)
mesh.with_(color=None)  # error: call-arg
scanloom.show(mesh, beside={"other": mesh}, height=300)
scanloom.show(mesh, heigth=300)  # error: call-arg
scanloom.FuseParams(voxel=1.0)  # error: call-arg
scanloom.FuseParams(0.01)  # error: call-arg

# A mesh is a Mesh, an Open3D or trimesh mesh, or a pair of arrays.
ours: list[MeshLike] = [mesh, to_open3d(mesh), to_open3d_legacy(mesh), to_trimesh(mesh)]
clean(o3d.t.geometry.TriangleMesh())
clean(o3d.geometry.TriangleMesh())
clean(trimesh.creation.icosphere())
clean((np.zeros((3, 3)), np.array([[0, 1, 2]])))
topology(([[0.0, 0.0, 0.0]], [[0, 0, 0]]))
clean("mesh.ply")  # error: arg-type
clean(Path("mesh.ply"))  # error: arg-type
clean(np.zeros((3, 3)))  # error: arg-type
clean([[0.0, 0.0, 0.0]])  # error: arg-type
clean((np.zeros((3, 3)), np.array([[0, 1, 2]]), image))  # error: arg-type
clean(None)  # error: arg-type
clean(scan)  # error: arg-type
clean(clean(mesh))  # error: arg-type
clean(o3d.geometry.PointCloud())  # error: arg-type
clean(o3d.t.geometry.PointCloud())  # error: arg-type

# Results have types.
assert_type(scanloom.__version__, str)
assert_type(mesh, Mesh)
assert_type(scanloom.show(mesh), scanloom.Page)
assert_type(scan, Scan)
assert_type(scan.frames[0].camera, Camera)
assert_type(mesh.vertices, NDArray[np.float64])
assert_type(mesh.triangles, NDArray[np.int32])
assert_type(mesh.colors, NDArray[np.uint8] | None)
assert_type(fuse(scan).voxel_size, float)
assert_type(clean(mesh).mesh, Mesh)
assert_type(clean(mesh).changes.islands, int)
assert_type(certify(mesh, mesh).within_limits, bool | None)
assert_type(certify(mesh, mesh).color_bound_levels, float | None)
assert_type(decode("mesh.snm").levels, tuple[Mesh, ...])
assert_type(topology(mesh).is_manifold, bool)
assert_type(render(mesh, viewpoints(mesh)[0]), NDArray[np.uint8])
assert_type(planar_patches(mesh).triangle_patch, NDArray[np.int32])
assert_type(inspect(scan).diagnostics, tuple[scanloom.Diagnostic, ...])
assert_type(to_trimesh(mesh), trimesh.Trimesh)
assert_type(to_open3d(mesh), o3d.t.geometry.TriangleMesh)
assert_type(to_open3d_legacy(mesh), o3d.geometry.TriangleMesh)
assert_type(bake(mesh, mesh).mesh.texture, scanloom.Texture | None)
_ = fuse(scan).voxels  # error: attr-defined
_ = mesh.faces  # error: attr-defined
_ = mesh.colors.shape  # error: union-attr
fuse(scan).voxel_size = 0.5  # error: misc
depth(image, image)  # error: call-arg

# Each method of `simplify` has separate keywords and details.
simplify(mesh, ratio=0.1, lock=[0, 1], progress=lambda done, total: done < total)
simplify(mesh, scanloom.SimplifyParams(max_shape=0.01, max_color=20), triangles=1000)
simplify(mesh, ratios=0.1)  # error: call-overload
simplify(mesh, ratio="half")  # error: call-overload
simplify(mesh, max_texture=20)  # error: call-overload
simplify(mesh, record="yes", ratio=0.1)  # error: call-overload
assert_type(simplify(mesh, method="certified", max_shape=0.01).details.proven, bool)
assert_type(simplify(mesh, method="seams", ratio=0.1).details.seam_drift, float)
assert_type(simplify(mesh, ratio=0.1).vertex_source, NDArray[np.int32])
_ = simplify(mesh, method="quadric", ratio=0.1).details.proven  # error: attr-defined
# Parameters of one method are an object or a dict.
simplify(mesh, method="planar", planar=scanloom.PlanarParams(crease_angle=30))
simplify(mesh, method="planar", planar={"crease_angle": 30})
simplify(mesh, ratio=0.1, seams={"duplicate_penalty": 0.2})
simplify(mesh, scanloom.SimplifyParams(planar=scanloom.PlanarParams(noise_angle=0)), method="planar")
simplify(mesh, method="planar", planar={"angle": 30})  # error: call-overload
simplify(mesh, method="planar", planar={"crease_angle": "flat"})  # error: call-overload
simplify(mesh, crease_angle=30)  # error: call-overload
_ = scanloom.SimplifyParams().crease_angle  # error: attr-defined
assert_type(scanloom.SimplifyParams().planar.crease_angle, float)
depth_scan(scan, sgbm={"p1": 100}, matcher="hh4")
depth_scan(scan, sgbm=scanloom.SgbmParams(left_right="match"))
depth_scan(scan, sgbm={"p3": 100})  # error: arg-type
depth_scan(scan, p1=100)  # error: call-arg
planar_patches(mesh, max_shape=0.01, threads=2)
planar_patches(mesh, ratio=0.1)  # error: call-arg
_ = simplify(mesh, ratio=0.1, record=True).record.replay(ratio=0.5)  # error: union-attr
