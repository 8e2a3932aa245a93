"""Stages of the scan pipeline, as plain functions on in-memory data.

>>> from scanloom import clean, depth, fuse, read_scan, simplify
>>> fused = fuse(read_scan("my_scan"))
>>> light = simplify(clean(fused.mesh).mesh, ratio=0.1).mesh

Each name below that is a verb is a function, in a file of its name in the room of its stage. A room is
imported when one of its names is first used, and Open3D, OpenCV, SciPy and trimesh when a function first
needs them, so importing this package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if __name__ == "stages":
    # Imported from the top of a checkout: use `scanloom.stages`, so that no module is loaded twice.
    import_module("scanloom").add_alias(__name__)

# For editors and type checkers. `PYTHONPATH=.:docs python -m making.keywords` writes these imports and
# `__all__` from `_NAMES_OF`, from which names are fetched while the program runs.
if TYPE_CHECKING:
    from scanloom.stages.adjusting.adjust import AdjustParams, adjust
    from scanloom.stages.adjusting.adjusted import Adjusted
    from scanloom.stages.cleaning.check import Checked, CheckParams, check
    from scanloom.stages.cleaning.clean import Cleaned, CleanParams, clean
    from scanloom.stages.cleaning.repair import Repaired, RepairParams, repair
    from scanloom.stages.comparing.align import Alignment, align
    from scanloom.stages.comparing.certify import Certificate, CertifyParams, certify
    from scanloom.stages.comparing.change import ChangeParams, Changes, changes
    from scanloom.stages.comparing.compare import CompareParams, Comparison, compare
    from scanloom.stages.comparing.deviations import DeviationParams, Deviations, deviations
    from scanloom.stages.diagnostics.collector import DiagnosticWarning, collecting
    from scanloom.stages.diagnostics.diagnostic import Diagnostic, Severity
    from scanloom.stages.diagnostics.errors import (
        InputError,
        MeshError,
        ScanloomError,
        StageError,
        UsageError,
    )
    from scanloom.stages.exporting.export import Exported, ExportParams, export
    from scanloom.stages.exporting.presets import preset
    from scanloom.stages.fusion.fuse import Fused, fuse
    from scanloom.stages.fusion.params import FuseParams
    from scanloom.stages.inspecting.coverage.coverage import coverage
    from scanloom.stages.inspecting.coverage.covered import Coverage
    from scanloom.stages.inspecting.coverage.params import CoverageParams
    from scanloom.stages.inspecting.coverage.place import Place
    from scanloom.stages.inspecting.inspect import inspect
    from scanloom.stages.inspecting.inspection import Inspection
    from scanloom.stages.normal_meshes.normal_mesh import NormalMesh, Offsets, decode
    from scanloom.stages.normal_meshes.remesh import RemeshParams, remesh
    from scanloom.stages.picturing.compare_views import ViewComparison, ViewsParams, compare_views
    from scanloom.stages.picturing.render import Viewpoint, render
    from scanloom.stages.picturing.viewpoints import viewpoints
    from scanloom.stages.registration.params import RegisterParams
    from scanloom.stages.registration.register import register
    from scanloom.stages.registration.registered import Registration
    from scanloom.stages.scans.model.scan import Camera, Frame, Scan, StereoRig
    from scanloom.stages.scans.params import ScanParams
    from scanloom.stages.scans.read import read_scan
    from scanloom.stages.simplification.certified.params import CertifiedParams
    from scanloom.stages.simplification.jia01.params import Jia01Params
    from scanloom.stages.simplification.planar.params import PatchParams, PlanarParams
    from scanloom.stages.simplification.planar.patches import Patches
    from scanloom.stages.simplification.planar.run import planar_patches
    from scanloom.stages.simplification.records.load import load_record
    from scanloom.stages.simplification.records.record import CollapseRecord
    from scanloom.stages.simplification.records.steps import ReplayParams
    from scanloom.stages.simplification.regions import Box, Sphere
    from scanloom.stages.simplification.seams.params import SeamsParams
    from scanloom.stages.simplification.simplify import Simplified, SimplifyParams, simplify
    from scanloom.stages.simplification.tradeoff import Tradeoff, TradeoffParams, tradeoff
    from scanloom.stages.stereo.completed_scan import completed_scan
    from scanloom.stages.stereo.depth import DepthParams, depth, depth_scan
    from scanloom.stages.stereo.depth_map import DepthMap
    from scanloom.stages.stereo.disparity import Disparity, stereo_disparity
    from scanloom.stages.stereo.params import SgbmParams
    from scanloom.stages.stereo.views_depth import views_depth
    from scanloom.stages.surface.cloud_files import read_cloud
    from scanloom.stages.surface.convert import MeshLike, as_mesh, to_open3d, to_open3d_legacy, to_trimesh
    from scanloom.stages.surface.mesh import Mesh
    from scanloom.stages.surface.mesh_files import read_mesh, write_mesh
    from scanloom.stages.surface.texture import Image, Material, Texture
    from scanloom.stages.surface.topology import Topology, topology
    from scanloom.stages.texturing.bake import Baked, BakeParams, bake
    from scanloom.stages.texturing.texture import Textured, TextureParams, texture

    __version__: str

# Public names by module.
_NAMES_OF = {
    "adjusting.adjust": ("AdjustParams", "adjust"),
    "adjusting.adjusted": ("Adjusted",),
    "cleaning.check": ("CheckParams", "Checked", "check"),
    "cleaning.clean": ("Cleaned", "CleanParams", "clean"),
    "cleaning.repair": ("RepairParams", "Repaired", "repair"),
    "comparing.align": ("Alignment", "align"),
    "comparing.certify": ("Certificate", "CertifyParams", "certify"),
    "comparing.change": ("ChangeParams", "Changes", "changes"),
    "comparing.compare": ("CompareParams", "Comparison", "compare"),
    "comparing.deviations": ("DeviationParams", "Deviations", "deviations"),
    "simplification.tradeoff": ("Tradeoff", "TradeoffParams", "tradeoff"),
    "inspecting.coverage.coverage": ("coverage",),
    "inspecting.coverage.covered": ("Coverage",),
    "inspecting.coverage.params": ("CoverageParams",),
    "inspecting.coverage.place": ("Place",),
    "diagnostics.collector": ("DiagnosticWarning", "collecting"),
    "diagnostics.diagnostic": ("Diagnostic", "Severity"),
    "diagnostics.errors": ("InputError", "MeshError", "ScanloomError", "StageError", "UsageError"),
    "exporting.export": ("ExportParams", "Exported", "export"),
    "exporting.presets": ("preset",),
    "fusion.fuse": ("Fused", "fuse"),
    "fusion.params": ("FuseParams",),
    "inspecting.inspect": ("inspect",),
    "inspecting.inspection": ("Inspection",),
    "normal_meshes.normal_mesh": ("NormalMesh", "Offsets", "decode"),
    "normal_meshes.remesh": ("RemeshParams", "remesh"),
    "picturing.compare_views": ("ViewComparison", "ViewsParams", "compare_views"),
    "picturing.render": ("Viewpoint", "render"),
    "picturing.viewpoints": ("viewpoints",),
    "registration.params": ("RegisterParams",),
    "registration.register": ("register",),
    "registration.registered": ("Registration",),
    "scans.params": ("ScanParams",),
    "scans.read": ("read_scan",),
    "scans.model.scan": ("Camera", "Frame", "Scan", "StereoRig"),
    "simplification.certified.params": ("CertifiedParams",),
    "simplification.jia01.params": ("Jia01Params",),
    "simplification.planar.params": ("PatchParams", "PlanarParams"),
    "simplification.planar.patches": ("Patches",),
    "simplification.planar.run": ("planar_patches",),
    "simplification.records.load": ("load_record",),
    "simplification.records.record": ("CollapseRecord",),
    "simplification.records.steps": ("ReplayParams",),
    "simplification.regions": ("Box", "Sphere"),
    "simplification.seams.params": ("SeamsParams",),
    "simplification.simplify": ("Simplified", "SimplifyParams", "simplify"),
    "stereo.completed_scan": ("completed_scan",),
    "stereo.depth": ("DepthParams", "depth", "depth_scan"),
    "stereo.depth_map": ("DepthMap",),
    "stereo.disparity": ("Disparity", "stereo_disparity"),
    "stereo.params": ("SgbmParams",),
    "stereo.views_depth": ("views_depth",),
    "surface.cloud_files": ("read_cloud",),
    "surface.convert": (
        "MeshLike",
        "as_mesh",
        "to_open3d",
        "to_open3d_legacy",
        "to_trimesh",
    ),
    "surface.mesh": ("Mesh",),
    "surface.mesh_files": ("read_mesh", "write_mesh"),
    "surface.texture": ("Image", "Material", "Texture"),
    "surface.topology": ("Topology", "topology"),
    "texturing.bake": ("Baked", "BakeParams", "bake"),
    "texturing.texture": ("TextureParams", "Textured", "texture"),
}
_MODULE_OF = {name: f"scanloom.stages.{module}" for module, names in _NAMES_OF.items() for name in names}

__all__ = [
    "AdjustParams",
    "Adjusted",
    "Alignment",
    "BakeParams",
    "Baked",
    "Box",
    "Camera",
    "Certificate",
    "CertifiedParams",
    "CertifyParams",
    "ChangeParams",
    "Changes",
    "CheckParams",
    "Checked",
    "CleanParams",
    "Cleaned",
    "CollapseRecord",
    "CompareParams",
    "Comparison",
    "Coverage",
    "CoverageParams",
    "DepthMap",
    "DepthParams",
    "DeviationParams",
    "Deviations",
    "Diagnostic",
    "DiagnosticWarning",
    "Disparity",
    "ExportParams",
    "Exported",
    "Frame",
    "FuseParams",
    "Fused",
    "Image",
    "InputError",
    "Inspection",
    "Jia01Params",
    "Material",
    "Mesh",
    "MeshError",
    "MeshLike",
    "NormalMesh",
    "Offsets",
    "PatchParams",
    "Patches",
    "Place",
    "PlanarParams",
    "RegisterParams",
    "Registration",
    "RemeshParams",
    "RepairParams",
    "Repaired",
    "ReplayParams",
    "Scan",
    "ScanParams",
    "ScanloomError",
    "SeamsParams",
    "Severity",
    "SgbmParams",
    "Simplified",
    "SimplifyParams",
    "Sphere",
    "StageError",
    "StereoRig",
    "Texture",
    "TextureParams",
    "Textured",
    "Topology",
    "Tradeoff",
    "TradeoffParams",
    "UsageError",
    "ViewComparison",
    "Viewpoint",
    "ViewsParams",
    "__version__",
    "adjust",
    "align",
    "as_mesh",
    "bake",
    "certify",
    "changes",
    "check",
    "clean",
    "collecting",
    "compare",
    "compare_views",
    "completed_scan",
    "coverage",
    "decode",
    "depth",
    "depth_scan",
    "deviations",
    "export",
    "fuse",
    "inspect",
    "load_record",
    "planar_patches",
    "preset",
    "read_cloud",
    "read_mesh",
    "read_scan",
    "register",
    "remesh",
    "render",
    "repair",
    "simplify",
    "stereo_disparity",
    "texture",
    "to_open3d",
    "to_open3d_legacy",
    "to_trimesh",
    "topology",
    "tradeoff",
    "viewpoints",
    "views_depth",
    "write_mesh",
]


# Hidden from type checkers: to them, what the imports above do not name is not there.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            value = import_module("scanloom.stages.files.written_by").installed_version()
        elif name in _MODULE_OF:
            value = getattr(import_module(_MODULE_OF[name]), name)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted(__all__)
