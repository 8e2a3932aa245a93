"""Configuration of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from scanloom.pipeline.cache.cache_size import CacheParams
from scanloom.pipeline.evaluation.params import ReportParams
from scanloom.pipeline.quality_presets import QUALITIES
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.steps.bake import BakeSection
from scanloom.pipeline.steps.coverage import CoverageSection
from scanloom.pipeline.steps.export import ExportSection
from scanloom.pipeline.steps.lod import LodSection
from scanloom.pipeline.steps.refine import RefineSection
from scanloom.pipeline.steps.remesh import RemeshSection
from scanloom.pipeline.steps.texture import TextureSection
from scanloom.pipeline.steps.tiles import TilesSection
from scanloom.pipeline.steps.upright import UprightSection
from scanloom.stages.adjusting.adjust import AdjustParams
from scanloom.stages.cleaning.clean import CleanParams
from scanloom.stages.comparing.compare import CompareParams
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.registration.params import RegisterParams
from scanloom.stages.registration.structure.params import StructureParams
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.simplification.simplify import SimplifyParams
from scanloom.stages.stereo.depth import DepthParams


@dataclass(frozen=True)
class Config(Sections):
    """All parameters of a run by section; each section's class describes its parameters.

    `Config()` has the defaults, `Config.from_quality("draft")` the values of a quality preset.
    """

    QUALITIES: ClassVar[Mapping[str, Mapping[str, Mapping[str, Any]]]] = QUALITIES

    scan: ScanParams = field(default_factory=ScanParams)
    structure: StructureParams = field(default_factory=StructureParams)
    depth: DepthParams = field(default_factory=DepthParams)
    register: RegisterParams = field(default_factory=RegisterParams)
    adjust: AdjustParams = field(default_factory=AdjustParams)
    fuse: FuseParams = field(default_factory=FuseParams)
    clean: CleanParams = field(default_factory=CleanParams)
    refine: RefineSection = field(default_factory=RefineSection)
    upright: UprightSection = field(default_factory=UprightSection)
    simplify: SimplifyParams = field(default_factory=SimplifyParams)
    texture: TextureSection = field(default_factory=TextureSection)
    # Parameters for reading the folder of `texture.images`, like `scan` for the scan folder.
    photos: ScanParams = field(default_factory=ScanParams)
    bake: BakeSection = field(default_factory=BakeSection)
    remesh: RemeshSection = field(default_factory=RemeshSection)
    lod: LodSection = field(default_factory=LodSection)
    tiles: TilesSection = field(default_factory=TilesSection)
    export: ExportSection = field(default_factory=ExportSection)
    coverage: CoverageSection = field(default_factory=CoverageSection)
    # Fewer samples than the default of `compare`, because every run computes the report.
    compare: CompareParams = field(default_factory=lambda: CompareParams(samples=200_000))
    report: ReportParams = field(default_factory=ReportParams)
    cache: CacheParams = field(default_factory=CacheParams)
