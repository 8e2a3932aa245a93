"""What is odd about poses that were found, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stages.registration.chain import Chain
from stages.registration.graph import Edge
from stages.registration.motion import Motion, angle
from stages.scans.poses import inverted
from stages.scans.scan import Frame, Pose, SkippedFrame

_STILL_M, _STILL_RAD = 0.005, np.radians(0.5)
_DARK = 8.0


def of_pieces(count: int, usable: int, piece: int, breaks: Sequence[SkippedFrame]) -> Iterator[str]:
    """Yield what is to be said of a scan that fell into pieces."""
    if count > 1:
        another = f" (register.piece={1 if piece > 1 else 2} for another)" if usable > 1 else ""
        more = f" and {len(breaks) - 1} more" if len(breaks) > 1 else ""
        yield (
            f"the frames fall into {count} pieces that could not be joined; piece {piece} is used{another}. "
            f"The chain broke at {breaks[0].name}{more}: {breaks[0].reason}"
        )


def of_poses(
    frames: Sequence[Frame],
    chain: Chain,
    poses: Sequence[Pose],
    used: Sequence[Edge],
    wrong: Sequence[Edge],
) -> Iterator[str]:
    """Yield what is odd about the poses of the piece that is used, and the edges of all."""
    motions = [motion for motion in chain.motions.values() if isinstance(motion, Motion)]
    split = [motion for motion in motions if motion.is_split]
    if len(split) > 0.1 * max(len(motions), 1):
        yield (
            f"in {len(split)} of {len(motions)} steps parts of the view move differently: something moves on "
            "its own (a person, a turntable), or colour and depth do not belong together. What most of the "
            "surface does was taken for the camera's motion"
        )
    loops = [edge for edge in (*used, *wrong) if not edge.is_certain]
    if len(wrong) > max(0.5 * len(loops), 3):
        yield (
            f"{len(wrong)} of {len(loops)} places that look as if they were seen before do not fit the path: "
            "it is bent, or the scene holds things that look the same; see path.ply"
        )
    if poses and all(np.linalg.norm(pose[:3, 3] - poses[0][:3, 3]) < _STILL_M for pose in poses):
        turned = max(angle(inverted(poses[0]) @ pose) for pose in poses)
        if turned < _STILL_RAD:
            yield (
                "the camera does not move: all frames show the scene from one place; a thing that was turned "
                "in front of it is registered alone with register.subject=object"
            )
    dark = [number for number, one in chain.seen.items() if one.mean_color < _DARK]
    if dark:
        yield f"{len(dark)} colour images are black, the first is that of frame {frames[dark[0]].name}"
    same = sum(
        np.linalg.norm(m.target_from_source[:3, 3]) < 1e-5 and angle(m.target_from_source) < 1e-5
        for m in motions
    )
    if same:
        yield f"{same} frames are the same as the one before"
