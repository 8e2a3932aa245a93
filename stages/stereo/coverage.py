"""Depth coverage of views, with warnings if little is left.

The report counts the pixels lost at each step.
"""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.stereo.codes import DEPTH_COVERAGE_LOW, DEPTH_OBJECT_INCOMPLETE, DEPTH_SCENE_INCOMPLETE
from scanloom.stages.stereo.params import SWEEP, DepthParams

# Minimum depth coverage: of an object with known outline, and of whole images, where much may be outside of
# every partner's view.
_MIN_OBJECT_COVERAGE = 0.5
_MIN_IMAGE_COVERAGE = 0.15
# Minimum ratio of pixels that a step must have removed to be named in the warning.
_MIN_REPORTED_RATIO = 0.1


@dataclass(frozen=True)
class CoverageCounts:
    """Pixel counts of one view or of several.

    Attributes
    ----------
    total : all pixels.
    foreground : pixels of the scene: neither masked out nor backdrop.
    textureless : `foreground` pixels without texture, treated as background.
    matched : remaining `foreground` pixels with depth from any partner.
    consistent : `matched` pixels that enough other views agree with.
    hull_filled : pixels filled from the visual hull.
    plane_filled : pixels filled from planes.
    outlined : pixels of views in which a mask or a backdrop separates the object.
    """

    total: int = 0
    foreground: int = 0
    textureless: int = 0
    matched: int = 0
    consistent: int = 0
    hull_filled: int = 0
    plane_filled: int = 0
    outlined: int = 0

    def __add__(self, other: CoverageCounts) -> CoverageCounts:
        """Return the sum of both counts."""
        return CoverageCounts(
            self.total + other.total,
            self.foreground + other.foreground,
            self.textureless + other.textureless,
            self.matched + other.matched,
            self.consistent + other.consistent,
            self.hull_filled + other.hull_filled,
            self.plane_filled + other.plane_filled,
            self.outlined + other.outlined,
        )


def report_coverage(counts: CoverageCounts, params: DepthParams) -> None:
    """Warn if depth covers little, or if much of it was filled."""
    _report_low_coverage(counts, params)
    ratio = _compute_filled_ratio(counts.hull_filled, counts)
    if ratio >= _MIN_REPORTED_RATIO:
        emit(
            DEPTH_OBJECT_INCOMPLETE.warning(
                "{share:.0%} of the object's depth is not measured, but filled from the visual hull of its "
                "silhouettes (depth.fill_from_visual_hull=false drops it; more views measure more)",
                share=ratio,
            )
        )
    ratio = _compute_filled_ratio(counts.plane_filled, counts)
    if ratio >= _MIN_REPORTED_RATIO:
        emit(
            DEPTH_SCENE_INCOMPLETE.warning(
                "{share:.0%} of the depth is not measured, but filled from planes through the depth around "
                "it (depth.fill_from_planes=false drops it)",
                share=ratio,
            )
        )


def _report_low_coverage(counts: CoverageCounts, params: DepthParams) -> None:
    is_object = counts.outlined > counts.total / 2
    min_coverage = _MIN_OBJECT_COVERAGE if is_object else _MIN_IMAGE_COVERAGE
    kept = counts.consistent + counts.plane_filled
    if not counts.foreground or kept >= min_coverage * counts.foreground:
        return
    area = "the pixels inside masks or in front of the backdrop" if is_object else "the views' pixels"
    rest = counts.foreground - counts.textureless
    uncertain_text, advice = "", "a lower depth.min_consistent_views keeps more"
    if params.views == SWEEP:
        uncertain_text = "have low confidence or "
        advice = "depth.min_confidence=128 and a lower depth.min_consistent_views keep more"
    steps = (
        (counts.textureless, "have too little texture (depth.max_backdrop_contrast=0 keeps them)"),
        (
            rest - counts.matched,
            (
                "have no reliable match in another view (depth.min_confidence=1 and "
                "depth.sgbm.uniqueness=0 keep more)"
            ),
        ),
        (
            counts.matched - kept,
            f"{uncertain_text}are not confirmed by {params.min_consistent_views} other views ({advice})",
        ),
    )
    ratios = [(count / counts.foreground, text) for count, text in steps]
    reasons = ", ".join(
        f"{share:.0%} {text}" for share, text in sorted(ratios, reverse=True) if share >= _MIN_REPORTED_RATIO
    )
    emit(
        DEPTH_COVERAGE_LOW.warning(
            "depth covers only {share:.0%} of {what}: {named}",
            share=kept / counts.foreground,
            what=area,
            named=reasons,
        )
    )


def _compute_filled_ratio(filled: int, counts: CoverageCounts) -> float:
    return filled / max(counts.consistent + filled, 1)
