"""Stages of the scan pipeline, as plain functions on in-memory data.

>>> from stages import clean, depth, fuse, read_scan, simplify
>>> fused = fuse(read_scan("my_scan"))
>>> light = simplify(clean(fused.mesh).mesh, ratio=0.1).mesh

Each name below that is a verb is a function; its module of the same name holds the parameter class
(`from stages.simplify import SimplifyParams`). Open3D, OpenCV, SciPy and trimesh are imported when
first used, so importing this package is cheap.
"""

from stages.bake import Baked, BakeParams, bake
from stages.certify import Certificate, CertifyParams, certify
from stages.clean import Cleaned, CleanParams, clean
from stages.collapse_record import CollapseRecord, load_record
from stages.collapse_steps import ReplayParams
from stages.compare import CompareParams, Comparison, compare
from stages.convert import MeshLike, as_mesh, to_open3d, to_open3d_legacy, to_trimesh
from stages.depth import DepthMap, DepthParams, depth, depth_scan
from stages.errors import InputError, MeshError, ScanloomError, StageError, UsageError
from stages.fuse import Fused, FuseParams, fuse
from stages.inspection import Inspection, inspect
from stages.layouts import ScanParams, read_scan
from stages.mesh import Mesh
from stages.mesh_files import read_mesh, write_mesh
from stages.normal_mesh import NormalMesh, Offsets, decode
from stages.patches import Patches
from stages.planar import planar_patches
from stages.planar_params import PatchParams
from stages.regions import Box, Sphere
from stages.register import RegisterParams, Registration, register
from stages.remesh import RemeshParams, remesh
from stages.render import View, render
from stages.scan import Camera, Frame, Scan, StereoRig
from stages.simplify import Simplified, SimplifyParams, simplify
from stages.texture import Image, Material, Texture
from stages.topology import Topology, topology
from stages.viewpoints import viewpoints
from stages.views import views_depth

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
    "View",
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
