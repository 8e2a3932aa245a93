"""Links that nothing confirms, in chains that broke elsewhere: no frame hangs on a few points alone."""

from __future__ import annotations

from collections.abc import Sequence

from scanloom.stages.registration.graph import Edge, pieces

# A link alone is believed where so much of the surface meets, and more where it is told by a few points: the
# keys of a keyboard look alike, and a blurred view of them fits where it does not belong. A step by surfaces
# alone began where the frame before was.
_LEAST_FITNESS, _SURE_POINTS, _SURE_FITNESS = 0.4, 15, 0.6


def confirmed(keys: Sequence[int], edges: Sequence[Edge]) -> list[Edge]:
    """Return the edges without those that alone join two parts and are not sure.

    Parameters
    ----------
    keys : places of the key frames in the scan. Of the chain, only frames that follow each other are parted:
        those between two key frames go with both.
    """
    kept = list(edges)
    for edge in edges:
        motion = edge.motion
        is_few = 0 < motion.points < _SURE_POINTS
        least = _SURE_FITNESS if is_few else _LEAST_FITNESS
        is_between = edge.is_certain and keys[edge.source] - keys[edge.target] != 1
        if motion.fitness >= least or is_between:
            continue
        others = [one for one in kept if one is not edge]
        if len(pieces(len(keys), others)) > len(pieces(len(keys), kept)):
            kept = others
    return kept
