"""The configuration of a run."""

from __future__ import annotations

from dataclasses import dataclass, field

from stages.clean import CleanParams

from pipeline.report import ReportParams
from pipeline.sections import Sections
from stages.compare import CompareParams
from stages.depth import DepthParams
from stages.fuse import FuseParams
from stages.layouts import ScanParams
from stages.simplify import SimplifyParams


@dataclass(frozen=True)
class Config(Sections):
    """Every parameter of a run, by section; see each section's class."""

    scan: ScanParams = field(default_factory=ScanParams)
    depth: DepthParams = field(default_factory=DepthParams)
    fuse: FuseParams = field(default_factory=FuseParams)
    clean: CleanParams = field(default_factory=CleanParams)
    simplify: SimplifyParams = field(default_factory=SimplifyParams)
    compare: CompareParams = field(default_factory=CompareParams)
    report: ReportParams = field(default_factory=ReportParams)
