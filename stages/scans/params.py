"""Parameters of reading a scan: layout, scale, and the parameters of all layouts."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import param
from scanloom.stages.scans.layout_table import LAYOUTS
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.tags import TAG_FAMILIES

# Parameters that make a scan metric; they exclude each other.
_SCALE_PARAMETERS = ("scale", "known_distance", "tag_size")


@dataclass(frozen=True, kw_only=True)
class ScanParams(ReadingParams):
    """Parameters of reading a scan folder; unset ones are taken from the folder."""

    layout: str | None = param(
        None,
        "Layout of the folder; by default it is detected.",
        choices=tuple(layout.name for layout in LAYOUTS),
    )
    scale: float | None = param(
        None,
        "Metres per unit of a scan that is not metric (COLMAP, nerfstudio). All lengths are multiplied by "
        "it, including depth.",
        unit="m",
        low=0,
        low_open=True,
        high=1e9,
    )
    known_distance: str | None = param(
        None,
        "Known distance that determines the scale: its length in units of the scan and in metres, `1.37 "
        "0.75`, or two points and their distance in metres, `x,y,z x,y,z 0.75`.",
    )
    tag_size: float | None = param(
        None,
        "Edge length of the black square of tags in the scene, from which the scale is estimated. All tags "
        "have the same size, and at least one is visible in two photos.",
        unit="m",
        low=0,
        low_open=True,
        high=1e3,
    )
    tag_family: str = param(
        "apriltag-36h11", "Family of the tags with edge `tag_size`.", choices=TAG_FAMILIES
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [name for name in _SCALE_PARAMETERS if getattr(self, name) is not None]
        if len(given) > 1:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "{given} and {given_2} both set the scale",
                remedy="remove one of them.",
                given=given[0],
                given_2=given[1],
            )
        self.resolve_scale()

    def resolve_scale(self) -> float | None:
        """Return the metres per unit from `scale` or `known_distance`.

        Returns None if neither is given.

        Raises
        ------
        UsageError
            If `known_distance` cannot be parsed or is not positive.
        """
        if self.known_distance is None:
            return self.scale
        words = self.known_distance.split()
        try:
            measured = [[float(number) for number in word.split(",")] for word in words[:-1]]
            metres = float(words[-1]) if words else math.nan
        except ValueError:
            measured, metres = [], math.nan
        shape = [len(numbers) for numbers in measured]
        units = measured[0][0] if shape == [1] else math.dist(*measured) if shape == [3, 3] else math.nan
        if not (0 < units < math.inf and 0 < metres < math.inf):
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {known_distance!r}; it must be a measured length and its true length in metres, "
                "such as `1.37 0.75`, or two points and their distance in metres, such as `x,y,z "
                "x,y,z 0.75`.",
                DiagnosticLocation(parameter="known_distance"),
                known_distance=self.known_distance,
            )
        return metres / units
