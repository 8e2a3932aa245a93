"""Fuse brick by brick: as much of space at a time as fits into memory, the mesh on disk.

All frames are looked through once for the blocks they touch. Then space is cut in cubes that fit, and each is
fused from the frames that touch it, with a rim of blocks around it. The surface of each brick inside is kept
as a file: where there is one already, nothing is fused again. How often a voxel must have been seen is known
at the end, and is guessed before: if wrong, all is done once more. Joined they are, to the byte, what `fuse`
gives in one piece.
"""

from __future__ import annotations

import json
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.files.documents import read_document
from scanloom.stages.files.numpy_files import mapped
from scanloom.stages.fusion.adding import (
    Outcome,
    Work,
    add_frames,
    facts_of,
    least_weight,
    look_through,
    nothing_fused,
    own_volume,
    require_share,
)
from scanloom.stages.fusion.bricks import Cube, Seen, bricks_of, level_of, passes, touched_bricks
from scanloom.stages.fusion.crop import cut
from scanloom.stages.fusion.facts import Facts, MeshFigures
from scanloom.stages.fusion.joining import Joined, Piece, reading, write_piece
from scanloom.stages.fusion.voxels import Box, Keys, Volume, block_bytes, median_of
from scanloom.stages.fusion.writing import piece_level, write_fused, write_joined
from scanloom.stages.printing import by_figures, table
from scanloom.stages.progress import Progress, silent
from scanloom.stages.scans.model.scan import SkippedFrame

_COUNTS, _SKIPPED = "frame_counts.npy", "skipped.json"
# Version of these files: bricks of another one are not used.
_FORMAT = 2


class Kept(Protocol):
    """Where bricks are kept that were fused before."""

    def get(self, brick: Cube, frames: Sequence[int], decided: Mapping[str, Any]) -> Path | None:
        """Return the folder of a brick that was made of these frames, by their numbers; None of none."""

    def store(
        self, brick: Cube, frames: Sequence[int], decided: Mapping[str, Any], make: Callable[[Path], None]
    ) -> Path:
        """Have a brick's files written into a folder, and return it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FusedInBricks(Facts):
    """A fused mesh in a file, and how it came about.

    Attributes
    ----------
    path : of a PLY file, with its table of pieces beside it; see scanloom.stages.surface.pieces.
    mesh_figures : how large it is.
    bricks, fused_bricks : how many there are, and how many of them had to be fused.
    """

    path: Path
    mesh_figures: MeshFigures
    bricks: int
    fused_bricks: int

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return the figures for a report, JSON-able, units in the names."""
        return self.figures_of(self.mesh_figures) | {"bricks": self.bricks, "bricks_fused": self.fused_bricks}


def fuse_in_bricks(
    work: Work, result: Path, *, kept: Kept | None = None, progress: Progress = silent
) -> FusedInBricks:
    """Fuse frames with depth and poses into a mesh that is written piece by piece.

    Parameters
    ----------
    work : of several frames.
    result : the PLY file to write.
    kept : where bricks are kept for the next time; None for nowhere.
    progress : called after each frame that was looked through, and for the frames of each cube.

    Raises
    ------
    InputError, StageError
        As `fuse`; a single brick may outgrow the memory, too.
    """
    size, voxel_size = work.params.brick_size, work.plan.voxel_size
    # The pieces of the result are made of whole bricks.
    most = piece_level(voxel_size)
    level = min(level_of(size, voxel_size), most) if size else most
    index = _index(work, level, progress)
    with _somewhere(kept, result.parent) as kept:
        # A frame that touches a block measured some of its voxels: about half.
        min_weight = work.params.min_weight or least_weight(index.typical / 2, work.frames)
        made = _make(work, index, level, kept, min_weight, progress)
        counts = sum(map(_read_counts, made.folders), np.zeros(256, np.int64))
        known = work.params.min_weight or least_weight(median_of(counts), work.frames)
        if known != min_weight:
            min_weight = known
            made = _make(work, index, level, kept, min_weight, progress)
        outcomes = _outcomes(work, index, made)
        joined = Joined(made.bricks, made.folders)
        if not joined.triangle_count:
            raise nothing_fused(work, outcomes, min_weight)
        figures = _write(work, joined, result)
    return FusedInBricks(
        path=result,
        mesh_figures=figures,
        bricks=len(made.bricks),
        fused_bricks=made.fused,
        **facts_of(work, outcomes, min_weight, made.volume_bytes, "CPU:0"),
    )


@dataclass(frozen=True, eq=False)
class _Index:
    """What a look through all frames tells.

    Attributes
    ----------
    outcomes : what became of each, by its depth.
    blocks : keys of all blocks that are touched, in their order.
    typical : how many frames touch the median one.
    frames : by brick, the numbers of the frames that its surface may depend on.
    """

    outcomes: list[Outcome]
    blocks: Keys
    typical: float
    frames: Mapping[int, list[int]]


def _index(work: Work, level: int, progress: Progress) -> _Index:
    seen, frames = Seen(), defaultdict(list)

    def note(number: int, keys: Keys) -> None:
        seen.add(keys)
        for brick in touched_bricks(keys, level):
            frames[brick].append(number)

    outcomes = look_through(work, note, progress)
    keys, times = seen.all()
    return _Index(outcomes, keys, float(np.median(times)) if len(times) else 0.0, frames)


@dataclass
class _Made:
    """The bricks and their folders, in order; what had to be done for them."""

    bricks: list[Cube]
    folders: list[Path]
    fused: int
    volume_bytes: int


def _make(work: Work, index: _Index, level: int, kept: Kept, min_weight: int, progress: Progress) -> _Made:
    """Fuse the bricks that are not kept, as many at a time as fit."""
    most_blocks = int(work.params.memory * 1e6 / block_bytes(color=work.color))
    with_blocks = {int(number) for number in np.unique(index.blocks >> np.uint64(3 * level))}
    decided = _decided(work, min_weight)
    made = _Made([], [], 0, 0)
    for cube in passes(index.blocks, level, most_blocks):
        bricks = bricks_of(cube, with_blocks, level)
        folders = {brick: kept.get(brick, index.frames[brick.number], decided) for brick in bricks}
        missing = [brick for brick, folder in folders.items() if folder is None]
        if missing:
            numbers = sorted({frame for brick in missing for frame in index.frames[brick.number]})
            volume = own_volume(work, _around(missing))
            outcomes = add_frames(work, volume, [work.frames[i] for i in numbers], progress)
            reasons = {
                number: one.diagnostic
                for number, one in zip(numbers, outcomes, strict=True)
                if isinstance(one, SkippedFrame)
            }
            made.volume_bytes = max(made.volume_bytes, volume.bytes)
            made.fused += len(missing)
            for brick in missing:
                frames = index.frames[brick.number]
                # By places among the brick's own: other frames may come between before it is used again.
                skipped = {at: reasons[number] for at, number in enumerate(frames) if number in reasons}
                write = partial(_write_brick, volume, min_weight, brick, skipped)
                folders[brick] = kept.store(brick, frames, decided, write)
        made.bricks += bricks
        made.folders += [folder for folder in folders.values() if folder is not None]
    return made


def _decided(work: Work, min_weight: int) -> dict[str, Any]:
    """Return all that decides a brick beside its frames, JSON-able."""
    plan, params = work.plan, work.params
    return {
        "format": _FORMAT,
        "voxel_size": plan.voxel_size,
        "truncation": plan.truncation,
        "max_depth": plan.max_depth,
        "limits": asdict(plan.limits),
        "weighing": asdict(plan.weighing),
        "origin": plan.origin.tolist(),
        "crop": asdict(plan.crop),
        "reach": plan.reach,
        "color": work.color,
        "upsample": [params.upsample, work.factor],
        "min_weight": min_weight,
    }


def _around(bricks: Sequence[Cube]) -> Box:
    """Return the box of some bricks with a rim of one block."""
    x, y, z = np.min([brick.low for brick in bricks], axis=0) - 1
    right, top, back = np.max([brick.high for brick in bricks], axis=0) + 1
    return (int(x), int(y), int(z)), (int(right), int(top), int(back))


def _write_brick(
    volume: Volume, min_weight: int, brick: Cube, skipped: Mapping[int, Diagnostic], folder: Path
) -> None:
    """Write a brick's surface, how often its voxels were seen, and which frames were skipped, and why."""
    within = brick.low, brick.high
    np.save(folder / _COUNTS, volume.frame_counts(within))
    mesh, _, joints = volume.surface(min_weight, within)
    write_piece(folder, Piece(mesh.vertices, mesh.triangles, mesh.colors), joints)
    reasons = {at: diagnostic.figures() for at, diagnostic in skipped.items()}
    (folder / _SKIPPED).write_text(json.dumps(reasons) + "\n", encoding="utf-8", newline="\n")


def _read_counts(folder: Path) -> NDArray[np.int64]:
    with reading(folder):
        return np.array(mapped(folder / _COUNTS), np.int64).reshape(256)


def _outcomes(work: Work, index: _Index, made: _Made) -> list[Outcome]:
    """Return what became of all frames, also of those whose colours were no good where they were used."""
    outcomes = list(index.outcomes)
    for brick, folder in zip(made.bricks, made.folders, strict=True):
        with reading(folder):
            skipped = {
                int(at): Diagnostic.from_figures(figures)
                for at, figures in read_document(folder / _SKIPPED).items()
            }
        for at, diagnostic in skipped.items():
            number = index.frames[brick.number][at]
            outcomes[number] = SkippedFrame(work.frames[number].name, diagnostic)
    require_share(work, outcomes)
    return outcomes


def _write(work: Work, joined: Joined, result: Path) -> MeshFigures:
    """Write the whole; what is cut at a crop has room in memory."""
    plan = work.plan
    if not plan.crop:
        return write_joined(result, joined, plan, has_colors=work.color)
    mesh = joined.mesh()
    mesh = cut(mesh.with_(vertices=mesh.vertices + plan.origin), plan.crop)
    write_fused(result, mesh, plan)
    return MeshFigures.of(mesh)


@dataclass(frozen=True, eq=False)
class _Scratch:
    """Bricks of one fusion, which are found by nobody later."""

    folder: Path

    def get(self, brick: Cube, frames: Sequence[int], decided: Mapping[str, Any]) -> None:
        """Find nothing."""

    def store(
        self,
        brick: Cube,
        frames: Sequence[int],  # noqa: ARG002
        decided: Mapping[str, Any],  # noqa: ARG002
        make: Callable[[Path], None],
    ) -> Path:
        """Have a brick's files written."""
        folder = self.folder / str(brick.number)
        folder.mkdir(exist_ok=True)
        make(folder)
        return folder


@contextmanager
def _somewhere(kept: Kept | None, beside: Path) -> Iterator[Kept]:
    if kept is not None:
        yield kept
        return
    with tempfile.TemporaryDirectory(dir=beside, prefix=".bricks-") as folder:
        yield _Scratch(Path(folder))
