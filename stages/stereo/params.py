"""Parameters of the depth stage."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check_parameters, find_changed, param
from scanloom.stages.stereo.opencv_matching import LARGEST_DISPARITY

# Methods for single views.
SWEEP, PAIRS = "sweep", "pairs"
# Matchers: automatic choice, the built-in census matcher, and the fast mode of OpenCV.
AUTO, CENSUS, FAST = "auto", "census", "3way"
# Sections and parameters without effect on the census matcher.
_OPENCV_PARAMETERS = ("sgbm", "left_right_tolerance", "speckle_size", "speckle_range")
# From this number of pairs on, fusion observes most surfaces several times and rejects outliers of single
# pairs.
MIN_SEVERAL_PAIRS = 3
# Memory limit in bytes above which `auto` does not choose the census matcher.
_MAX_VOLUME_BYTES = 4 << 30


@dataclass(frozen=True, kw_only=True)
class SgbmParams:
    """Parameters of OpenCV's semi-global matchers: 3way, sgbm, hh4 and hh."""

    block_size: int = param(
        3,
        "Width of the matched blocks, odd: larger ones tolerate more noise, smaller ones keep detail",
        unit="px",
        low=1,
        high=11,
    )
    p1: int | None = param(
        None,
        "Penalty for a disparity change of 1 px between neighbours; 16·block_size² by default",
        low=0,
    )
    p2: int | None = param(
        None, "Penalty for a larger disparity change, above p1; 32·block_size² by default", low=1, high=10000
    )
    prefilter_cap: int = param(
        15,
        "Horizontal gradients are clipped to this before matching",
        unit="grey levels",
        low=15,
        high=63,
    )
    uniqueness: int | None = param(
        None,
        "Minimum margin of the best match over every other match; pixels below get no depth. Default: 20 for "
        "one or two pairs, 5 for more",
        unit="%",
        low=0,
        high=100,
    )
    left_right: str = param(
        "project",
        "Left–right check: project assigns each right pixel to the nearest surface; match also matches the "
        "right image, which takes twice the time and is slightly more accurate",
        choices=("project", "match"),
    )
    smooth: bool = param(
        False,
        "Smooth disparity while keeping image edges (weighted least squares): looks better, but gives worse "
        "meshes. Filled pixels keep their low confidence and get no depth",
    )
    smooth_lambda: float = param(1000.0, "Strength of the smoothing", low=0, low_open=True)
    smooth_sigma: float = param(
        1.5,
        "Sensitivity of the smoothing to image edges; smaller values keep weaker edges",
        unit="grey levels",
        low=0,
        low_open=True,
    )

    def __post_init__(self) -> None:
        check_parameters(self)
        if self.block_size % 2 == 0:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {block_size}; it must be odd.",
                DiagnosticLocation(parameter="block_size"),
                block_size=self.block_size,
            )
        if self.penalties[0] >= self.penalties[1]:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {penalties}; it must be below p2, {penalties_2}.",
                DiagnosticLocation(parameter="p1"),
                penalties=self.penalties[0],
                penalties_2=self.penalties[1],
            )

    @property
    def penalties(self) -> tuple[int, int]:
        """Return p1 and p2 with defaults resolved."""
        area = self.block_size**2
        return 16 * area if self.p1 is None else self.p1, 32 * area if self.p2 is None else self.p2


@dataclass(frozen=True, kw_only=True)
class DepthParams:
    """Parameters of the depth stage."""

    min_depth: float | None = param(
        None,
        "Minimum depth. Default, unless `disparities` is given: from the number of disparities in the "
        "calibration, else from disparities up to a quarter of the image width, narrowed for each pair",
        unit="m",
        low=0,
        low_open=True,
    )
    max_depth: float | None = param(
        None,
        "Maximum depth. By default only max_relative_depth_error limits the range",
        unit="m",
        low=0,
        low_open=True,
        common=True,
    )
    max_relative_depth_error: float = param(
        0.05,
        "Maximum expected depth error σ_z = z²/(f·b)·σ_d relative to depth z; farther depth is dropped",
        low=0,
        low_open=True,
        high=1,
    )
    disparity_sigma: float = param(
        0.25,
        "Standard deviation σ_d of the disparity of a correct match",
        unit="px",
        low=0,
        low_open=True,
        high=10,
    )
    min_confidence: int | None = param(
        None,
        "Pixels of lower confidence get no depth. For matcher census and for plane sweeps, confidence is 255 "
        "times the probability that depth is right; default: 204, or 128 for three or more pairs, because "
        "fusion rejects outliers. For other matchers, 128 is a spread of 1.5 px; default: 128, or 16 for "
        "three or more pairs",
        low=0,
        high=255,
    )
    matcher: str = param(
        AUTO,
        "Semi-global matcher. OpenCV modes: 3way aggregates costs along three paths and needs little memory; "
        "hh4 along four, slightly more accurate in twice the time; sgbm along five and hh along eight, "
        "without benefit. census is the built-in matcher: more coverage, and probabilities as confidence, in "
        "seven times the time. auto is census for one or two pairs, unless it needs more than 4 GB or an "
        "option of the OpenCV modes is given, else 3way",
        choices=(AUTO, FAST, "sgbm", "hh4", "hh", CENSUS),
    )
    model: str | None = param(
        None,
        "Network file FILE.onnx with its sidecar FILE.toml (`scanloom lab probe` guesses it), run by "
        "onnxruntime (`scanloom[network]`). A stereo network replaces the matcher; pixels that fail the "
        "left–right check get no depth. A monocular network fills missing depth, fitted to measured depth "
        "in scale and shift, with a confidence of 1",
        # The cache key includes the content of the file and its sidecar instead of the name.
        invalidates=False,
        is_path=True,
        common=True,
    )
    model_error: float = param(
        0.1,
        "Maximum relative error of a monocular network: per pixel between image and mirrored image, and in "
        "the median against measured depth; beyond it nothing is filled",
        low=0,
        low_open=True,
        high=1,
    )
    model_memory: float = param(
        8000,
        "Memory limit of a network process; as many run at once as pairs are matched in parallel",
        unit="MB",
        low=100,
        high=1e7,
        invalidates=False,
    )
    model_seconds: float = param(
        600,
        "Time limit of a network for an image or a pair, and for loading",
        unit="s",
        low=0,
        low_open=True,
        high=1e6,
        invalidates=False,
    )
    disparities: int | None = param(
        None,
        "Number of disparities to search, instead of the number derived from the depth range",
        unit="px",
        low=1,
        high=LARGEST_DISPARITY,
    )
    left_right_tolerance: float = param(
        1.0,
        "Maximum disparity difference between a pixel and its match in the left–right check",
        unit="px",
        low=0,
        high=100,
    )
    speckle_size: int = param(
        100, "Connected components with fewer pixels are dropped as speckles; 0 keeps all", unit="px", low=0
    )
    speckle_range: float = param(
        1.0,
        "Maximum disparity difference between connected neighbours in the speckle filter",
        unit="px",
        low=0,
        high=100,
    )
    min_texture: float = param(
        0.5,
        "Minimum mean difference between pixels two apart in a row; pixels with less texture, such as a "
        "clipped sky, get no depth",
        unit="grey levels",
        low=0,
    )
    refine: bool = param(
        True,
        "Refine disparities to sub-pixel accuracy from image intensities, which removes the matcher's bias "
        "on slanted surfaces. No effect on smoothed disparities",
    )
    views: str = param(
        SWEEP,
        "Method for single views with poses: sweep matches a view with all partners at once by a plane "
        "sweep; pairs matches it with each partner as a stereo pair, with `matcher`",
        choices=(SWEEP, PAIRS),
    )
    partners: int = param(
        6,
        "Single views: maximum number of partner views that a view is matched with",
        unit="views",
        low=1,
        high=32,
    )
    min_consistent_views: int = param(
        2,
        "Single views: minimum number of other views whose depth maps must agree for depth to be kept",
        unit="views",
        low=0,
        high=64,
    )
    consistency_tolerance: float | None = param(
        None,
        "Single views: maximum relative difference of depth between maps that agree. Default: the depth "
        "difference of one pixel of disparity between neighbouring views",
        low=0,
        low_open=True,
        high=1,
    )
    max_backdrop_contrast: float = param(
        3.0,
        "Single views: texture limit of the backdrop, the mean difference between pixels two apart. Plainer "
        "pixels match anything and get no depth. If all views have a backdrop of one colour around the "
        "object, only pixels of this colour are dropped; if masks cut the object out, only masked pixels. 0 "
        "keeps all unmasked pixels",
        unit="grey levels",
        low=0,
    )
    fill_from_visual_hull: bool = param(
        True,
        "Single views of an object with masks or a backdrop: fill unmeasured depth from the visual hull of "
        "the silhouettes, offset to fit the measured depth around it, with a confidence of 1. Otherwise "
        "these pixels remain holes",
    )
    fill_from_planes: bool = param(
        True,
        "Single views of a scene (views=sweep): fill areas without texture from planes through the measured "
        "depth around them if other views agree, with a confidence of 1. Otherwise these pixels stay holes",
    )
    max_side: int = param(
        1600,
        "Single views: maximum image side; larger images are downscaled, with a warning",
        unit="px",
        low=64,
        high=1 << 14,
    )
    max_pose_error: float = param(
        2.0,
        "Single views: maximum median epipolar error of feature matches between views. Scans with a larger "
        "error are rejected, because little of their depth would be right",
        unit="px",
        low=0,
        low_open=True,
    )
    fix_upside_down: bool = param(
        True,
        "Single views: rotate images by 180° that are upside down relative to their poses, with a warning",
    )
    max_skipped_ratio: float = param(
        0.5, "Maximum ratio of frames that cannot be used; scans with more are rejected", low=0, high=1
    )
    threads: int | None = param(
        None,
        "Number of pairs matched in parallel; one per core by default",
        low=1,
        high=256,
        invalidates=False,
    )
    sgbm: SgbmParams = field(default=SgbmParams())

    def __post_init__(self) -> None:
        check_parameters(self)
        if self.min_depth is not None and self.max_depth is not None and self.min_depth >= self.max_depth:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {min_depth:g} m; it must be below max_depth, {max_depth:g} m.",
                DiagnosticLocation(parameter="min_depth"),
                min_depth=self.min_depth,
                max_depth=self.max_depth,
            )
        if self.matcher == CENSUS:
            self.require_default(_OPENCV_PARAMETERS, f"matcher {CENSUS}")

    def uses_census(self, pair_count: int, volume_bytes: int) -> bool:
        """Return True if the census matcher is used.

        Parameters
        ----------
        pair_count : number of pairs in the scan.
        volume_bytes : bytes of the cost volumes.
        """
        if self.matcher != AUTO:
            return self.matcher == CENSUS
        return (
            pair_count < MIN_SEVERAL_PAIRS
            and volume_bytes <= _MAX_VOLUME_BYTES
            and not self.find_changed_parameters(_OPENCV_PARAMETERS)
        )

    def find_changed_parameters(self, names: Collection[str]) -> list[str]:
        """Return changed parameters with these names, or in sections with these names."""
        return [name for name in find_changed(self) if name.partition(".")[0] in names]

    def require_default(self, names: Collection[str], context: str) -> None:
        """Raise UsageError for a changed parameter that would have no effect."""
        if idle := self.find_changed_parameters(names):
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "has no effect with {place}",
                DiagnosticLocation(parameter=idle[0]),
                remedy="omit it.",
                place=context,
            )


# Parameters without effect on plane sweeps.
PAIR_PARAMETERS = (
    "max_relative_depth_error",
    "disparity_sigma",
    "matcher",
    "disparities",
    *_OPENCV_PARAMETERS,
    "min_texture",
    "refine",
)
