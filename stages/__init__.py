"""Stages of the scan pipeline, as plain functions on in-memory data.

>>> from stages import clean, depth, fuse, read_scan, simplify
>>> fused = fuse(read_scan("my_scan"))
>>> light = simplify(clean(fused.mesh).mesh, ratio=0.1).mesh

Each name below that is a verb is a function, in a file of its name in the room of its stage. Open3D, OpenCV,
SciPy and trimesh are imported when first used, so importing this package is cheap.
"""

from stages.cleaning.clean import Cleaned, CleanParams, clean
from stages.comparing.certify import Certificate, CertifyParams, certify
from stages.comparing.compare import CompareParams, Comparison, compare
from stages.errors import InputError, MeshError, ScanloomError, StageError, UsageError
from stages.fusion.fuse import Fused, fuse
from stages.fusion.params import FuseParams
from stages.inspecting.inspect import Inspection, inspect
from stages.normal_meshes.normal_mesh import NormalMesh, Offsets, decode
from stages.normal_meshes.remesh import RemeshParams, remesh
from stages.picturing.render import Viewpoint, render
from stages.picturing.viewpoints import viewpoints
from stages.registration.register import RegisterParams, Registration, register
from stages.scans.params import ScanParams
from stages.scans.read import read_scan
from stages.scans.scan import Camera, Frame, Scan, StereoRig
from stages.simplification.planar.params import PatchParams
from stages.simplification.planar.patches import Patches
from stages.simplification.planar.run import planar_patches
from stages.simplification.records.load import load_record
from stages.simplification.records.record import CollapseRecord
from stages.simplification.records.steps import ReplayParams
from stages.simplification.regions import Box, Sphere
from stages.simplification.simplify import Simplified, SimplifyParams, simplify
from stages.stereo.depth import DepthMap, DepthParams, depth, depth_scan
from stages.stereo.views_depth import views_depth
from stages.surface.convert import MeshLike, as_mesh, to_open3d, to_open3d_legacy, to_trimesh
from stages.surface.mesh import Mesh
from stages.surface.mesh_files import read_mesh, write_mesh
from stages.surface.texture import Image, Material, Texture
from stages.surface.topology import Topology, topology
from stages.texturing.bake import Baked, BakeParams, bake

__all__ = [
    "BakeParams",
    "Baked",
    "Box",
    "Camera",
    "Certificate",
    "CertifyParams",
    "CleanParams",
    "Cleaned",
    "CollapseRecord",
    "CompareParams",
    "Comparison",
    "DepthMap",
    "DepthParams",
    "Frame",
    "FuseParams",
    "Fused",
    "Image",
    "InputError",
    "Inspection",
    "Material",
    "Mesh",
    "MeshError",
    "MeshLike",
    "NormalMesh",
    "Offsets",
    "PatchParams",
    "Patches",
    "RegisterParams",
    "Registration",
    "RemeshParams",
    "ReplayParams",
    "Scan",
    "ScanParams",
    "ScanloomError",
    "Simplified",
    "SimplifyParams",
    "Sphere",
    "StageError",
    "StereoRig",
    "Texture",
    "Topology",
    "UsageError",
    "Viewpoint",
    "as_mesh",
    "bake",
    "certify",
    "clean",
    "compare",
    "decode",
    "depth",
    "depth_scan",
    "fuse",
    "inspect",
    "load_record",
    "planar_patches",
    "read_mesh",
    "read_scan",
    "register",
    "remesh",
    "render",
    "simplify",
    "to_open3d",
    "to_open3d_legacy",
    "to_trimesh",
    "topology",
    "viewpoints",
    "views_depth",
    "write_mesh",
]
