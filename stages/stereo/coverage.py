"""How much of what views show has depth, and what took the rest: if it is little, that is told."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from stages.scans.scan import Frame, SkippedFrame
from stages.stereo.depth import DepthMap
from stages.stereo.params import SWEEP, DepthParams

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


Result = tuple[Frame, DepthMap | SkippedFrame, Counts]


def with_warning(
    results: Iterator[Result], params: DepthParams
) -> Iterator[tuple[Frame, DepthMap | SkippedFrame]]:
    """Pass the results of views on, the last map among them with warnings on the depth of all.

    From each map on, what comes is held back until the next one does.
    """
    total = Counts()
    held: list[tuple[Frame, DepthMap | SkippedFrame]] = []
    for frame, result, counts in results:
        total += counts
        if isinstance(result, DepthMap):
            yield from held
            held = []
        held.append((frame, result))
    said = [one for one in (why_little(total, params), why_filled(total), why_planar(total)) if one]
    for frame, result in held:
        if said and isinstance(result, DepthMap):
            yield frame, replace(result, warnings=(*result.warnings, *said))
        else:
            yield frame, result


def why_little(counts: Counts, params: DepthParams) -> str | None:
    """Return what is to be said of a scan whose depth covers little, or None."""
    is_thing = counts.outlined > counts.all / 2
    least = _OF_A_THING if is_thing else _OF_AN_IMAGE
    kept = counts.kept + counts.planar
    if not counts.shown or kept >= least * counts.shown:
        return None
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
            "matched no other view surely (depth.min_confidence=1 and depth.uniqueness=0 ask less)",
        ),
        (
            counts.matched - kept,
            f"{unsure}is not seen alike by {params.agreeing_views} other views ({asks})",
        ),
    )
    shares = [(count / counts.shown, text) for count, text in steps]
    named = ", ".join(f"{share:.0%} {text}" for share, text in sorted(shares, reverse=True) if share >= _MUCH)
    return f"depth covers only {kept / counts.shown:.0%} of {what}: {named}"


def why_filled(counts: Counts) -> str | None:
    """Return what is to be said of a thing much of which was not measured, or None."""
    share = _of_all(counts.filled, counts)
    if share < _MUCH:
        return None
    return (
        f"{share:.0%} of the thing's depth was measured by no view, and is that of the hull of its "
        "silhouettes (depth.on_hull=false leaves it out; more views measure more)"
    )


def why_planar(counts: Counts) -> str | None:
    """Return what is to be said of views much of whose depth is that of planes, or None."""
    share = _of_all(counts.planar, counts)
    if share < _MUCH:
        return None
    return (
        f"{share:.0%} of the depth was measured by no view, and is that of planes on which measured depth "
        "around it lies (depth.on_planes=false leaves it out)"
    )


def _of_all(told: int, counts: Counts) -> float:
    """Return the share of told depth among all that there is."""
    return told / max(counts.kept + told, 1)
