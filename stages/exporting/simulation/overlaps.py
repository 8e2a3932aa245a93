"""Overlaps between the collision parts of different bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np

from scanloom.stages.exporting.simulation.body import Body
from scanloom.stages.exporting.simulation.convex_part import ConvexPart, PartSet, is_apart, measure_separation


@dataclass(frozen=True)
class Overlap:
    """Overlap of two bodies.

    Attributes
    ----------
    first, second : names of the bodies.
    pairs : number of pairs of parts that overlap.
    depth_m : no pair overlaps by more.
    """

    first: str
    second: str
    pairs: int
    depth_m: float

    def to_dict(self) -> dict[str, Any]:
        """Return the overlap as JSON-compatible values."""
        return asdict(self)


def find_overlaps(bodies: Sequence[Body]) -> list[Overlap]:
    """Find the bodies that overlap in the positions of the scan.

    Parts of bodies without an overlap are proven to be apart: a plane separates each pair.
    """
    found = []
    placed = [[part.translate(np.array(body.position)) for part in body.parts] for body in bodies]
    for (one, first), (other, second) in combinations(zip(bodies, placed, strict=True), 2):
        near = PartSet(second)
        depths = [_measure_depth(a, b) for a in first for b in near.list_touching(a)]
        depths = [depth for depth in depths if depth > 0]
        if depths:
            found.append(Overlap(one.name, other.name, len(depths), max(depths)))
    return found


def _measure_depth(first: ConvexPart, second: ConvexPart) -> float:
    """Return an upper bound of the depth by which two parts overlap; 0 if a plane separates them."""
    return 0.0 if is_apart(first, second) else -measure_separation(first, second)
