"""Depth coverage of views: pixels lost at each step, and warnings if little is left."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.stereo.codes import DEPTH_COVERAGE_LOW, DEPTH_OBJECT_INCOMPLETE, DEPTH_SCENE_INCOMPLETE
from scanloom.stages.stereo.params import SWEEP, DepthParams

# Depth is little if it covers less than this share of a thing whose outline is known, or of whole images,
# much of which may lie where no partner looks.
_OF_A_THING = 0.5
_OF_AN_IMAGE = 0.15
# A step is named if it took at least this share.
_MUCH = 0.1


@dataclass(frozen=True)
class Counts:
    """Pixels of one view, or of several.

    Attributes
    ----------
    all, shown : all, and those that show the scene: not masked out, nor a backdrop.
    plain : those of them without texture all around, which are taken for background.
    matched : those of the others that were measured with some partner.
    kept : those of them that enough other views agree with.
    filled : those that no view measured, and that lie on the hull of the silhouettes.
    planar : those that no view measured, and that lie on planes of what is measured around.
    outlined : pixels of views whose scene is told from the rest by a mask or a backdrop.
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
        """Return the sum."""
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
    """Warn if the depth of a scan's views covers little, or if much of it was not measured."""
    _report_low_coverage(counts, params)
    share = _share_of_depth(counts.filled, counts)
    if share >= _MUCH:
        emit(
            DEPTH_OBJECT_INCOMPLETE.warning(
                "{share:.0%} of the thing's depth was measured by no view, and is that of the hull of its "
                "silhouettes (depth.on_hull=false leaves it out; more views measure more)",
                share=share,
            )
        )
    share = _share_of_depth(counts.planar, counts)
    if share >= _MUCH:
        emit(
            DEPTH_SCENE_INCOMPLETE.warning(
                "{share:.0%} of the depth was measured by no view, and is that of planes on which measured "
                "depth around it lies (depth.on_planes=false leaves it out)",
                share=share,
            )
        )


def _report_low_coverage(counts: Counts, params: DepthParams) -> None:
    is_thing = counts.outlined > counts.all / 2
    least = _OF_A_THING if is_thing else _OF_AN_IMAGE
    kept = counts.kept + counts.planar
    if not counts.shown or kept >= least * counts.shown:
        return
    what = "what the masks or the backdrop leave of the views" if is_thing else "the views' pixels"
    rest = counts.shown - counts.plain
    unsure, asks = "", "depth.agreeing_views asks for fewer"
    if params.views == SWEEP:
        unsure = "is not sure, or "
        asks = "depth.min_confidence=128 and a lower depth.agreeing_views ask less"
    steps = (
        (counts.plain, "has too little texture (depth.backdrop=0 keeps it)"),
        (
            rest - counts.matched,
            "matched no other view surely (depth.min_confidence=1 and depth.sgbm.uniqueness=0 ask less)",
        ),
        (
            counts.matched - kept,
            f"{unsure}is not seen alike by {params.agreeing_views} other views ({asks})",
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
