"""Out-of-core fusion in bricks that fit in memory.

A first pass over all frames records the blocks each frame touches. Space is then split into cubes that fit in
memory. Each cube is fused from the frames that touch it, with a margin of one block. The mesh of each brick
in the cube is stored in a file and reused by later runs.

The minimum observation count is only known after all bricks. It is guessed first, and the run is repeated if
the guess was wrong. The stitched mesh is byte-identical to the in-memory result of `fuse`.
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
# Version of the brick files; stored bricks of another version are ignored.
_FORMAT = 2


class Kept(Protocol):
    """Store of fused bricks."""

    def get(self, brick: Cube, frames: Sequence[int], decided: Mapping[str, Any]) -> Path | None:
        """Look up the folder of a stored brick.

        Parameters
        ----------
        brick : brick to find.
        frames : indices of the frames that touch the brick.
        decided : every other input of the brick, as returned by `_decided`.

        Returns
        -------
        The folder; None if no stored brick has the same inputs.
        """

    def store(
        self, brick: Cube, frames: Sequence[int], decided: Mapping[str, Any], make: Callable[[Path], None]
    ) -> Path:
        """Store a brick.

        Parameters
        ----------
        brick, frames, decided : as for `get`.
        make : writes the files of the brick into a given folder.

        Returns
        -------
        The folder.
        """


@dataclass(frozen=True, eq=False, kw_only=True)
class FusedInBricks(Facts):
    """Fused mesh in a file, with statistics of the fusion.

    Attributes
    ----------
    path : PLY file; its chunk table is stored next to it (see scanloom.stages.surface.pieces).
    mesh_figures : bounding box and element counts of the mesh.
    bricks, fused_bricks : number of bricks, and of bricks that were fused rather than reused.
    """

    path: Path
    mesh_figures: MeshFigures
    bricks: int
    fused_bricks: int

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return JSON-ready metrics for the report, with units in the keys."""
        return self.figures_of(self.mesh_figures) | {"bricks": self.bricks, "bricks_fused": self.fused_bricks}


def fuse_in_bricks(
    work: Work, result: Path, *, kept: Kept | None = None, progress: Progress = silent
) -> FusedInBricks:
    """Fuse frames brick by brick, and write a PLY file.

    Parameters
    ----------
    work : fusion of at least two frames.
    result : PLY file to write.
    kept : store for fused bricks, reused by later runs; None discards the bricks.
    progress : called after each frame of the first pass, and after each frame of each cube.

    Raises
    ------
    InputError, StageError
        As `fuse`; also StageError if a single brick exceeds the memory limit.
    """
    size, voxel_size = work.params.brick_size, work.plan.voxel_size
    # Chunks of the written mesh consist of whole bricks.
    most = piece_level(voxel_size)
    level = min(level_of(size, voxel_size), most) if size else most
    index = _index(work, level, progress)
    with _somewhere(kept, result.parent) as kept:
        # Initial guess: a frame that touches a block observes about half of its voxels.
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
    """Result of the first pass over all frames.

    Attributes
    ----------
    outcomes : outcome of each frame, from its depth alone.
    blocks : sorted Z-order keys of all touched blocks.
    typical : number of frames that touch the median block.
    frames : by Z-order index of a brick, indices of the frames that its surface may depend on.
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
    """Bricks of a fusion.

    Attributes
    ----------
    bricks, folders : the bricks in Z-order, and the folders of their files.
    fused : number of bricks that were fused rather than reused.
    volume_bytes : peak memory of the volume.
    """

    bricks: list[Cube]
    folders: list[Path]
    fused: int
    volume_bytes: int


def _make(work: Work, index: _Index, level: int, kept: Kept, min_weight: int, progress: Progress) -> _Made:
    """Fuse the bricks missing from the store.

    As many bricks as fit in memory are fused at a time.
    """
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
                # Keyed by index within the frames of the brick: global frame indices may shift before the
                # brick is reused.
                skipped = {at: reasons[number] for at, number in enumerate(frames) if number in reasons}
                write = partial(_write_brick, volume, min_weight, brick, skipped)
                folders[brick] = kept.store(brick, frames, decided, write)
        made.bricks += bricks
        made.folders += [folder for folder in folders.values() if folder is not None]
    return made


def _decided(work: Work, min_weight: int) -> dict[str, Any]:
    """Return every input of a brick except its frames, JSON-ready.

    A stored brick is reused only if all inputs match.
    """
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
    """Return the bounding box of bricks, plus one block on each side."""
    x, y, z = np.min([brick.low for brick in bricks], axis=0) - 1
    right, top, back = np.max([brick.high for brick in bricks], axis=0) + 1
    return (int(x), int(y), int(z)), (int(right), int(top), int(back))


def _write_brick(
    volume: Volume, min_weight: int, brick: Cube, skipped: Mapping[int, Diagnostic], folder: Path
) -> None:
    """Write the mesh, observation histogram and skipped frames of a brick."""
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
    """Return the outcome of every frame of the scan.

    A frame with readable depth is skipped if its colour turns out unreadable during the integration.
    """
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
    """Write the stitched mesh. A cropped mesh is assembled in memory first."""
    plan = work.plan
    if not plan.crop:
        return write_joined(result, joined, plan, has_colors=work.color)
    mesh = joined.mesh()
    mesh = cut(mesh.with_(vertices=mesh.vertices + plan.origin), plan.crop)
    write_fused(result, mesh, plan)
    return MeshFigures.of(mesh)


@dataclass(frozen=True, eq=False)
class _Scratch:
    """Temporary brick store for a single run; lookups always miss."""

    folder: Path

    def get(self, brick: Cube, frames: Sequence[int], decided: Mapping[str, Any]) -> None:
        """Return None: every brick is fused anew."""

    def store(
        self,
        brick: Cube,
        frames: Sequence[int],  # noqa: ARG002
        decided: Mapping[str, Any],  # noqa: ARG002
        make: Callable[[Path], None],
    ) -> Path:
        """Write the files of a brick into a subfolder."""
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
