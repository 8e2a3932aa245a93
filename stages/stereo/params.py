"""How the depth stage matches pairs and views, and what it keeps."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check, find_changed, param
from scanloom.stages.stereo.matching import LARGEST_DISPARITY

# How views are measured.
SWEEP, PAIRS = "sweep", "pairs"
# Our own matcher, and the fast one of OpenCV's.
AUTO, CENSUS, FAST = "auto", "census", "3way"
# Section and parameters that our own matcher does not have.
_OF_OTHERS = ("sgbm", "left_right_tolerance", "speckle_size", "speckle_range")
# From this many pairs on, fusion sees most surfaces several times and drops what a single pair says.
SEVERAL = 3
# Bytes that our own matcher may take where it was not asked for.
_LARGEST_VOLUME = 4 << 30


@dataclass(frozen=True, kw_only=True)
class SgbmParams:
    """Parameters of OpenCV's semi-global matchers: 3way, sgbm, hh4 and hh."""

    block_size: int = param(
        3,
        "Width of the compared blocks, odd: larger ones stand more noise, smaller ones keep detail",
        unit="px",
        low=1,
        high=11,
    )
    p1: int | None = param(
        None,
        "Penalty for a change of disparity by 1 px between neighbours; 16·block_size² by default",
        low=0,
    )
    p2: int | None = param(
        None, "Penalty for a larger change, more than p1; 32·block_size² by default", low=1, high=10000
    )
    prefilter_cap: int = param(
        15,
        "Horizontal gradients are cut off here before comparison",
        unit="grey levels",
        low=15,
        high=63,
    )
    uniqueness: int | None = param(
        None,
        "By how much the best match must beat every other, else there is none. Default: 20 for one or two "
        "pairs, 5 for more",
        unit="%",
        low=0,
        high=100,
    )
    left_right: str = param(
        "project",
        "How left and right are checked against each other: project claims each right pixel for the nearest "
        "surface, match matches the right image too, which takes twice the time and errs a little less",
        choices=("project", "match"),
    )
    smooth: bool = param(
        False,
        "Smooth disparity along the image's edges (weighted least squares): pleasant to look at, fuses "
        "worse. What it fills in keeps its low confidence and gets no depth",
    )
    smooth_lambda: float = param(1000.0, "Strength of the smoothing", low=0, low_open=True)
    smooth_sigma: float = param(
        1.5, "How strong an edge of the image stops the smoothing", unit="grey levels", low=0, low_open=True
    )

    def __post_init__(self) -> None:
        check(self)
        if self.block_size % 2 == 0:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {block_size}; it must be odd.",
                Where(parameter="block_size"),
                block_size=self.block_size,
            )
        if self.penalties[0] >= self.penalties[1]:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {penalties}; it must be below p2, {penalties_2}.",
                Where(parameter="p1"),
                penalties=self.penalties[0],
                penalties_2=self.penalties[1],
            )

    @property
    def penalties(self) -> tuple[int, int]:
        """Return p1 and p2 as used."""
        area = self.block_size**2
        return 16 * area if self.p1 is None else self.p1, 32 * area if self.p2 is None else self.p2


@dataclass(frozen=True, kw_only=True)
class DepthParams:
    """Parameters of the depth stage."""

    min_depth: float | None = param(
        None,
        "Nearest depth that is looked for. If neither it nor `disparities` is given: the calibration's own "
        "number of disparities, else up to a quarter of the image's width, narrowed to what a pair uses",
        unit="m",
        low=0,
        low_open=True,
    )
    max_depth: float | None = param(
        None,
        "Farthest depth that is looked for and used; without it, the depth error alone bounds the range",
        unit="m",
        low=0,
        low_open=True,
        common=True,
    )
    max_relative_depth_error: float = param(
        0.05,
        "Depth is used up to where its expected error σ_z = z²/(f·b)·σ_d is this share of it",
        low=0,
        low_open=True,
        high=1,
    )
    disparity_sigma: float = param(
        0.25, "Standard deviation σ_d of a good match's disparity", unit="px", low=0, low_open=True, high=10
    )
    min_confidence: int | None = param(
        None,
        "Pixels of lower confidence get no depth. Of matcher census, and of views that are swept, it is 255 "
        "times the probability of being right: 204 by default, 128 for three and more pairs, since fusion "
        "drops what only one of them says; of the other matchers 128 is a spread of about 1.5 px: 128, or 16",
        low=0,
        high=255,
    )
    matcher: str = param(
        AUTO,
        "Semi-global matcher: 3way gathers costs along three paths, in little memory; hh4 along four, "
        "erring a little less for twice the time; sgbm along five and hh along eight, for no gain. census is "
        "our own, which covers more, with confidences that are probabilities, for seven times the time. auto "
        "is census for one or two pairs, unless it would take more than 4 GB or an option of the others is "
        "given, and 3way for more",
        choices=(AUTO, FAST, "sgbm", "hh4", "hh", CENSUS),
    )
    model: str | None = param(
        None,
        "File of a network of your own, FILE.onnx, with FILE.toml beside it (`scanloom lab probe` guesses "
        "it), run by onnxruntime (`scanloom[network]`). One of pairs takes the matcher's place; what left "
        "and right do not agree on is no depth. One of single images fills in depth where none was "
        "measured, with scale and shift as measured depth has them, of confidence 1",
        # What is in the file and beside it decides, not its name.
        invalidates=False,
        is_path=True,
        common=True,
    )
    model_error: float = param(
        0.1,
        "A network of single images fills in depth where what it says of the mirrored image differs by less "
        "than this share, and in images where it differs from measured depth by less in the median",
        low=0,
        low_open=True,
        high=1,
    )
    model_memory: float = param(
        8000,
        "A network is given up that takes more; as many run at once as pairs are matched at the same time",
        unit="MB",
        low=100,
        high=1e7,
        invalidates=False,
    )
    model_seconds: float = param(
        600,
        "A network is given up that takes longer for an image or a pair, or to be loaded",
        unit="s",
        low=0,
        low_open=True,
        high=1e6,
        invalidates=False,
    )
    disparities: int | None = param(
        None,
        "Number of disparities that are tried, in place of those that follow from the depth range",
        unit="px",
        low=1,
        high=LARGEST_DISPARITY,
    )
    left_right_tolerance: float = param(
        1.0,
        "How far the disparities of a pixel and of its match may differ",
        unit="px",
        low=0,
        high=100,
    )
    speckle_size: int = param(
        100, "Connected pieces of fewer pixels are dropped as speckles; 0 keeps all", unit="px", low=0
    )
    speckle_range: float = param(
        1.0, "Neighbours whose disparities differ by more are not connected", unit="px", low=0, high=100
    )
    min_texture: float = param(
        0.5,
        "Where pixels two apart in a row differ by less in the mean around, as in a clipped sky, nothing "
        "was measured",
        unit="grey levels",
        low=0,
    )
    refine: bool = param(
        True,
        "Move each disparity by the fraction of a pixel at which the images agree best; takes away the "
        "matcher's bias on slanted surfaces. Smoothed disparities stay as they are",
    )
    views: str = param(
        SWEEP,
        "How single views with poses are measured: sweep matches a view with all of its partners at once, "
        "plane by plane; pairs with each of them alone, as `matcher` says",
        choices=(SWEEP, PAIRS),
    )
    partners: int = param(
        6,
        "Single views with poses: each is matched with at most so many others",
        unit="views",
        low=1,
        high=32,
    )
    agreeing_views: int = param(
        2,
        "Single views: depth is kept where so many other views' depth maps agree with it",
        unit="views",
        low=0,
        high=64,
    )
    agreement: float | None = param(
        None,
        "Single views: share of depth by which maps that agree may differ. Default: what a pixel of "
        "disparity makes between neighbouring views",
        low=0,
        low_open=True,
        high=1,
    )
    backdrop: float = param(
        3.0,
        "Single views: where pixels two apart differ by less in the mean around, the image may show a "
        "backdrop, which matches anything and gets no depth. Where all views have one of the same colour "
        "around the thing, only what looks like it goes; where masks cut the thing out, they alone tell. "
        "0 keeps all that no mask leaves out",
        unit="grey levels",
        low=0,
    )
    on_hull: bool = param(
        True,
        "Single views of a thing that masks or a backdrop tell from the rest: what no view measured gets the "
        "depth of the hull of the silhouettes, as far behind it as measured depth around is, and is marked. "
        "Else the thing has holes there",
    )
    on_planes: bool = param(
        True,
        "Single views of a scene, swept: places without texture between measured depth get the depth of the "
        "plane that this lies on, where other views say the same, and are marked. Else they are left open",
    )
    max_side: int = param(
        1600,
        "Single views: larger images are made smaller, to this longer side, with a warning",
        unit="px",
        low=64,
        high=1 << 14,
    )
    max_pose_error: float = param(
        2.0,
        "Single views: the scan is given up when points that two views recognise are off by more, in the "
        "median, from where poses and calibration put them; little of its depth would be right",
        unit="px",
        low=0,
        low_open=True,
    )
    turn_back: bool = param(
        True,
        "Single views: images that are upside down against their poses, as corners found in several show, "
        "are turned back, with a warning",
    )
    max_skipped: float = param(
        0.5, "The scan is given up when a larger share of its frames cannot be used", low=0, high=1
    )
    threads: int | None = param(
        None, "Pairs matched at the same time; one a core if not given", low=1, high=256, invalidates=False
    )
    sgbm: SgbmParams = field(default=SgbmParams())

    def __post_init__(self) -> None:
        check(self)
        if self.min_depth is not None and self.max_depth is not None and self.min_depth >= self.max_depth:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {min_depth:g} m; it must be below max_depth, {max_depth:g} m.",
                Where(parameter="min_depth"),
                min_depth=self.min_depth,
                max_depth=self.max_depth,
            )
        if self.matcher == CENSUS:
            self.require_default(_OF_OTHERS, f"matcher {CENSUS}")

    def is_own(self, pairs: int, volume: int) -> bool:
        """Return whether our own matcher measures so many pairs, whose volumes take so many bytes."""
        if self.matcher != AUTO:
            return self.matcher == CENSUS
        return pairs < SEVERAL and volume <= _LARGEST_VOLUME and not self.find_idle(_OF_OTHERS)

    def find_idle(self, names: Collection[str]) -> list[str]:
        """Return the parameters with these names, or in sections of these names, that were set."""
        return [name for name in find_changed(self) if name.partition(".")[0] in names]

    def require_default(self, names: Collection[str], place: str) -> None:
        """Raise UsageError for a parameter that was set and would do nothing."""
        if idle := self.find_idle(names):
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "has no effect with {place}",
                Where(parameter=idle[0]),
                remedy="leave it out.",
                place=place,
            )


# What views that are swept have no use for.
OF_PAIRS = (
    "max_relative_depth_error",
    "disparity_sigma",
    "matcher",
    "disparities",
    *_OF_OTHERS,
    "min_texture",
    "refine",
)
