"""Parameters of reading a scan: its layout, its scale, and what all layouts have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import param
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.tags import FAMILIES
from scanloom.stages.scans.table import LAYOUTS

# Parameters that make a scan metric; they exclude each other.
_SCALES = ("scale", "known_distance", "tag_size")


@dataclass(frozen=True, kw_only=True)
class ScanParams(ReadingParams):
    """Parameters of reading a scan folder; unset ones are taken from the folder."""

    layout: str | None = param(
        None,
        "Read the folder as this layout; by default it is recognised.",
        choices=tuple(layout.name for layout in LAYOUTS),
    )
    scale: float | None = param(
        None,
        "What a unit of the scan's world is, where its lengths are no metres (COLMAP, nerfstudio): they are "
        "multiplied by it, those of depth too.",
        unit="m",
        low=0,
        low_open=True,
        high=1e9,
    )
    known_distance: str | None = param(
        None,
        "A distance in the scan as it is measured without a scale, and what it is in metres, `1.37 0.75`, or "
        "two points and the metres between them, `x,y,z x,y,z 0.75`; the scale follows.",
    )
    tag_size: float | None = param(
        None,
        "Edge of the black square of tags in the photos, all of one size: they are found in two photos or "
        "more, and the scale follows.",
        unit="m",
        low=0,
        low_open=True,
        high=1e3,
    )
    tag_family: str = param("apriltag-36h11", "Which tags those of `tag_size` are.", choices=FAMILIES)

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [name for name in _SCALES if getattr(self, name) is not None]
        if len(given) > 1:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "{given} and {given_2} both say how long a unit is",
                remedy="leave one of them out.",
                given=given[0],
                given_2=given[1],
            )
        self.stated_scale()

    def stated_scale(self) -> float | None:
        """Return the metres per unit from `scale` or `known_distance`.

        None if neither is given.

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
                "is {known_distance!r}; it must be a distance as it is measured and in metres, `1.37 0.75`, "
                "or two points and the metres between them, `x,y,z x,y,z 0.75`.",
                Where(parameter="known_distance"),
                known_distance=self.known_distance,
            )
        return metres / units
