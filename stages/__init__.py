"""Stages of the scan pipeline, as plain functions on in-memory data.

>>> from scanloom import clean, depth, fuse, read_scan, simplify
>>> fused = fuse(read_scan("my_scan"))
>>> light = simplify(clean(fused.mesh).mesh, ratio=0.1).mesh

Each stage is a package; functions are in files of the same name. A package is imported on first use of one of
its names, and Open3D, OpenCV, SciPy and trimesh on the first call that needs them. Importing
`scanloom.stages`
is therefore fast.
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
    from scanloom.stages.adjusting.adjustment_result import Adjustment
    from scanloom.stages.cleaning.check import CheckParams, CheckResult, check
    from scanloom.stages.cleaning.clean import CleaningResult, CleanParams, clean
    from scanloom.stages.cleaning.repair import RepairParams, RepairResult, repair
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
    from scanloom.stages.exporting.export import ExportParams, ExportResult, export
    from scanloom.stages.exporting.presets import preset
    from scanloom.stages.exporting.simulation.export_simulation import (
        SimulationParams,
        SimulationResult,
        export_simulation,
    )
    from scanloom.stages.fusion.fuse import FusionResult, fuse
    from scanloom.stages.fusion.params import FuseParams
    from scanloom.stages.inspecting.coverage.coverage import coverage
    from scanloom.stages.inspecting.coverage.coverage_result import Coverage
    from scanloom.stages.inspecting.coverage.defect import CoverageDefect
    from scanloom.stages.inspecting.coverage.params import CoverageParams
    from scanloom.stages.inspecting.inspect import inspect
    from scanloom.stages.inspecting.inspection import Inspection
    from scanloom.stages.normal_meshes.normal_mesh import NormalMesh, Offsets, decode
    from scanloom.stages.normal_meshes.remesh import RemeshParams, remesh
    from scanloom.stages.refinement.params import RefineParams
    from scanloom.stages.refinement.refine import RefinementResult, refine
    from scanloom.stages.registration.params import RegisterParams
    from scanloom.stages.registration.register import register
    from scanloom.stages.registration.registration_result import Registration
    from scanloom.stages.registration.structure.frame_selection import extract_frames
    from scanloom.stages.registration.structure.params import StructureParams
    from scanloom.stages.registration.structure.reconstruct import Structure, reconstruct_cameras
    from scanloom.stages.rendering.image_comparison import ViewComparison, ViewsParams, compare_views
    from scanloom.stages.rendering.render import Viewpoint, render
    from scanloom.stages.rendering.viewpoints import viewpoints
    from scanloom.stages.scans.model.scan import Camera, Frame, Scan, StereoRig
    from scanloom.stages.scans.params import ScanParams
    from scanloom.stages.scans.reader import read_scan
    from scanloom.stages.simplification.certified.params import CertifiedParams
    from scanloom.stages.simplification.jia01.params import Jia01Params
    from scanloom.stages.simplification.planar.params import PatchParams, PlanarParams
    from scanloom.stages.simplification.planar.patches import Patches
    from scanloom.stages.simplification.planar.run import planar_patches
    from scanloom.stages.simplification.records.collapse_steps import ReplayParams
    from scanloom.stages.simplification.records.load import load_record
    from scanloom.stages.simplification.records.record import CollapseRecord
    from scanloom.stages.simplification.regions import Box, Sphere
    from scanloom.stages.simplification.seams.params import SeamsParams
    from scanloom.stages.simplification.simplify import SimplificationResult, SimplifyParams, simplify
    from scanloom.stages.simplification.tradeoff import Tradeoff, TradeoffParams, tradeoff
    from scanloom.stages.stereo.depth import DepthParams, depth, depth_scan
    from scanloom.stages.stereo.depth_completion import completed_scan
    from scanloom.stages.stereo.depth_map import DepthMap
    from scanloom.stages.stereo.disparity import Disparity, stereo_disparity
    from scanloom.stages.stereo.params import SgbmParams
    from scanloom.stages.stereo.views_depth import views_depth
    from scanloom.stages.surface.mesh import Mesh
    from scanloom.stages.surface.mesh_conversion import (
        MeshLike,
        as_mesh,
        to_open3d,
        to_open3d_legacy,
        to_trimesh,
    )
    from scanloom.stages.surface.mesh_files import read_mesh, write_mesh
    from scanloom.stages.surface.point_cloud_files import read_cloud
    from scanloom.stages.surface.texture import Image, Material, Texture
    from scanloom.stages.surface.topology import Topology, topology
    from scanloom.stages.texturing.bake import BakeParams, BakeResult, bake
    from scanloom.stages.texturing.texture import TextureParams, TextureResult, texture

    __version__: str

# Public names by module.
_NAMES_OF = {
    "adjusting.adjust": ("AdjustParams", "adjust"),
    "adjusting.adjustment_result": ("Adjustment",),
    "cleaning.check": ("CheckParams", "CheckResult", "check"),
    "cleaning.clean": ("CleaningResult", "CleanParams", "clean"),
    "cleaning.repair": ("RepairParams", "RepairResult", "repair"),
    "comparing.align": ("Alignment", "align"),
    "comparing.certify": ("Certificate", "CertifyParams", "certify"),
    "comparing.change": ("ChangeParams", "Changes", "changes"),
    "comparing.compare": ("CompareParams", "Comparison", "compare"),
    "comparing.deviations": ("DeviationParams", "Deviations", "deviations"),
    "simplification.tradeoff": ("Tradeoff", "TradeoffParams", "tradeoff"),
    "inspecting.coverage.coverage": ("coverage",),
    "inspecting.coverage.coverage_result": ("Coverage",),
    "inspecting.coverage.params": ("CoverageParams",),
    "inspecting.coverage.defect": ("CoverageDefect",),
    "diagnostics.collector": ("DiagnosticWarning", "collecting"),
    "diagnostics.diagnostic": ("Diagnostic", "Severity"),
    "diagnostics.errors": ("InputError", "MeshError", "ScanloomError", "StageError", "UsageError"),
    "exporting.export": ("ExportParams", "ExportResult", "export"),
    "exporting.presets": ("preset",),
    "exporting.simulation.export_simulation": (
        "SimulationParams",
        "SimulationResult",
        "export_simulation",
    ),
    "fusion.fuse": ("FusionResult", "fuse"),
    "fusion.params": ("FuseParams",),
    "inspecting.inspect": ("inspect",),
    "inspecting.inspection": ("Inspection",),
    "normal_meshes.normal_mesh": ("NormalMesh", "Offsets", "decode"),
    "normal_meshes.remesh": ("RemeshParams", "remesh"),
    "rendering.image_comparison": ("ViewComparison", "ViewsParams", "compare_views"),
    "rendering.render": ("Viewpoint", "render"),
    "rendering.viewpoints": ("viewpoints",),
    "refinement.params": ("RefineParams",),
    "refinement.refine": ("RefinementResult", "refine"),
    "registration.params": ("RegisterParams",),
    "registration.register": ("register",),
    "registration.registration_result": ("Registration",),
    "scans.params": ("ScanParams",),
    "scans.reader": ("read_scan",),
    "scans.model.scan": ("Camera", "Frame", "Scan", "StereoRig"),
    "simplification.certified.params": ("CertifiedParams",),
    "simplification.jia01.params": ("Jia01Params",),
    "simplification.planar.params": ("PatchParams", "PlanarParams"),
    "simplification.planar.patches": ("Patches",),
    "simplification.planar.run": ("planar_patches",),
    "simplification.records.load": ("load_record",),
    "simplification.records.record": ("CollapseRecord",),
    "simplification.records.collapse_steps": ("ReplayParams",),
    "simplification.regions": ("Box", "Sphere"),
    "simplification.seams.params": ("SeamsParams",),
    "simplification.simplify": ("SimplificationResult", "SimplifyParams", "simplify"),
    "stereo.depth_completion": ("completed_scan",),
    "stereo.depth": ("DepthParams", "depth", "depth_scan"),
    "stereo.depth_map": ("DepthMap",),
    "stereo.disparity": ("Disparity", "stereo_disparity"),
    "stereo.params": ("SgbmParams",),
    "stereo.views_depth": ("views_depth",),
    "registration.structure.frame_selection": ("extract_frames",),
    "registration.structure.params": ("StructureParams",),
    "registration.structure.reconstruct": ("Structure", "reconstruct_cameras"),
    "surface.point_cloud_files": ("read_cloud",),
    "surface.mesh_conversion": (
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
    "texturing.bake": ("BakeResult", "BakeParams", "bake"),
    "texturing.texture": ("TextureParams", "TextureResult", "texture"),
}
_MODULE_OF = {name: f"scanloom.stages.{module}" for module, names in _NAMES_OF.items() for name in names}

__all__ = [
    "AdjustParams",
    "Adjustment",
    "Alignment",
    "BakeParams",
    "BakeResult",
    "Box",
    "Camera",
    "Certificate",
    "CertifiedParams",
    "CertifyParams",
    "ChangeParams",
    "Changes",
    "CheckParams",
    "CheckResult",
    "CleanParams",
    "CleaningResult",
    "CollapseRecord",
    "CompareParams",
    "Comparison",
    "Coverage",
    "CoverageDefect",
    "CoverageParams",
    "DepthMap",
    "DepthParams",
    "DeviationParams",
    "Deviations",
    "Diagnostic",
    "DiagnosticWarning",
    "Disparity",
    "ExportParams",
    "ExportResult",
    "Frame",
    "FuseParams",
    "FusionResult",
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
    "PlanarParams",
    "RefineParams",
    "RefinementResult",
    "RegisterParams",
    "Registration",
    "RemeshParams",
    "RepairParams",
    "RepairResult",
    "ReplayParams",
    "Scan",
    "ScanParams",
    "ScanloomError",
    "SeamsParams",
    "Severity",
    "SgbmParams",
    "SimplificationResult",
    "SimplifyParams",
    "SimulationParams",
    "SimulationResult",
    "Sphere",
    "StageError",
    "StereoRig",
    "Structure",
    "StructureParams",
    "Texture",
    "TextureParams",
    "TextureResult",
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
    "export_simulation",
    "extract_frames",
    "fuse",
    "inspect",
    "load_record",
    "planar_patches",
    "preset",
    "read_cloud",
    "read_mesh",
    "read_scan",
    "reconstruct_cameras",
    "refine",
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


# Hidden from type checkers, so that they report names missing from the imports above.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            value = import_module("scanloom.stages.files.version").get_installed_version()
        elif name in _MODULE_OF:
            value = getattr(import_module(_MODULE_OF[name]), name)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted(__all__)
