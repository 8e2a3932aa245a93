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
_OF_A_THING = 0.5
_OF_AN_IMAGE = 0.15
# Minimum ratio of pixels that a step must have removed to be named in the warning.
_MUCH = 0.1


@dataclass(frozen=True)
class Counts:
    """Pixel counts of one view or of several.

    Attributes
    ----------
    all : all pixels.
    shown : pixels of the scene: neither masked out nor backdrop.
    plain : `shown` pixels without texture, treated as background.
    matched : remaining `shown` pixels with depth from any partner.
    kept : `matched` pixels that enough other views agree with.
    filled : pixels filled from the visual hull.
    planar : pixels filled from planes.
    outlined : pixels of views in which a mask or a backdrop separates the object.
    """

    all: int = 0
    shown: int = 0
    plain: int = 0
    matched: int = 0
    kept: int = 0
    filled: int = 0
    planar: int = 0
    outlined: int = 0

    def __add__(self, other: Counts) -> Counts:
        """Return the sum of both counts."""
        return Counts(
            self.all + other.all,
            self.shown + other.shown,
            self.plain + other.plain,
            self.matched + other.matched,
            self.kept + other.kept,
            self.filled + other.filled,
            self.planar + other.planar,
            self.outlined + other.outlined,
        )


def report_coverage(counts: Counts, params: DepthParams) -> None:
    """Warn if depth covers little, or if much of it was filled."""
    _report_low_coverage(counts, params)
    share = _share_of_depth(counts.filled, counts)
    if share >= _MUCH:
        emit(
            DEPTH_OBJECT_INCOMPLETE.warning(
                "{share:.0%} of the object's depth is not measured, but filled from the visual hull of its "
                "silhouettes (depth.on_hull=false drops it; more views measure more)",
                share=share,
            )
        )
    share = _share_of_depth(counts.planar, counts)
    if share >= _MUCH:
        emit(
            DEPTH_SCENE_INCOMPLETE.warning(
                "{share:.0%} of the depth is not measured, but filled from planes through the depth around "
                "it (depth.on_planes=false drops it)",
                share=share,
            )
        )


def _report_low_coverage(counts: Counts, params: DepthParams) -> None:
    is_thing = counts.outlined > counts.all / 2
    least = _OF_A_THING if is_thing else _OF_AN_IMAGE
    kept = counts.kept + counts.planar
    if not counts.shown or kept >= least * counts.shown:
        return
    what = "the pixels inside masks or in front of the backdrop" if is_thing else "the views' pixels"
    rest = counts.shown - counts.plain
    unsure, asks = "", "a lower depth.agreeing_views keeps more"
    if params.views == SWEEP:
        unsure = "have low confidence or "
        asks = "depth.min_confidence=128 and a lower depth.agreeing_views keep more"
    steps = (
        (counts.plain, "have too little texture (depth.backdrop=0 keeps them)"),
        (
            rest - counts.matched,
            (
                "have no reliable match in another view (depth.min_confidence=1 and "
                "depth.sgbm.uniqueness=0 keep more)"
            ),
        ),
        (
            counts.matched - kept,
            f"{unsure}are not confirmed by {params.agreeing_views} other views ({asks})",
        ),
    )
    shares = [(count / counts.shown, text) for count, text in steps]
    named = ", ".join(f"{share:.0%} {text}" for share, text in sorted(shares, reverse=True) if share >= _MUCH)
    emit(
        DEPTH_COVERAGE_LOW.warning(
            "depth covers only {share:.0%} of {what}: {named}",
            share=kept / counts.shown,
            what=what,
            named=named,
        )
    )


def _share_of_depth(filled: int, counts: Counts) -> float:
    return filled / max(counts.kept + filled, 1)
