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
from scanloom.stages.files.numpy_files import map_array
from scanloom.stages.fusion.brick_stitching import (
    BrickMesh,
    StitchedMesh,
    convert_read_errors,
    write_brick_mesh,
)
from scanloom.stages.fusion.bricks import (
    BlockCube,
    TouchedBlockCounter,
    compute_level,
    find_affected_bricks,
    select_bricks,
    split_into_passes,
)
from scanloom.stages.fusion.crop import crop_mesh
from scanloom.stages.fusion.fused_mesh_files import compute_chunk_level, write_fused_mesh, write_stitched_mesh
from scanloom.stages.fusion.fusion_statistics import FusionStatistics, MeshStatistics
from scanloom.stages.fusion.integration import (
    FrameOutcome,
    FusionJob,
    check_skipped_ratio,
    collect_statistics,
    collect_touched_blocks,
    create_volume,
    derive_min_observations,
    integrate_frames,
    make_empty_mesh_error,
)
from scanloom.stages.fusion.tsdf_volume import (
    BlockBox,
    BlockKeys,
    SparseVolume,
    compute_block_bytes,
    compute_histogram_median,
)
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.model.scan import SkippedFrame

_COUNTS_FILE, _SKIPPED_FILE = "frame_counts.npy", "skipped.json"
# Version of the brick files; stored bricks of another version are ignored.
_FORMAT = 2


class BrickStore(Protocol):
    """Store of fused bricks."""

    def get(self, brick: BlockCube, frames: Sequence[int], inputs: Mapping[str, Any]) -> Path | None:
        """Look up the folder of a stored brick.

        Parameters
        ----------
        brick : brick to find.
        frames : indices of the frames that touch the brick.
        inputs : every other input of the brick, as returned by `_collect_brick_inputs`.

        Returns
        -------
        The folder; None if no stored brick has the same inputs.
        """

    def store(
        self,
        brick: BlockCube,
        frames: Sequence[int],
        inputs: Mapping[str, Any],
        write_files: Callable[[Path], None],
    ) -> Path:
        """Store a brick.

        Parameters
        ----------
        brick, frames, inputs : as for `get`.
        write_files : writes the files of the brick into a given folder.

        Returns
        -------
        The folder.
        """


@dataclass(frozen=True, eq=False, kw_only=True)
class FusedInBricks(FusionStatistics):
    """Fused mesh in a file, with statistics of the fusion.

    Attributes
    ----------
    path : PLY file; its chunk table is stored next to it (see scanloom.stages.surface.chunked_ply).
    mesh_statistics : bounding box and element counts of the mesh.
    brick_count, fused_brick_count : number of bricks, and of bricks that were fused rather than reused.
    """

    path: Path
    mesh_statistics: MeshStatistics
    brick_count: int
    fused_brick_count: int

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-ready metrics for the report, with units in the keys."""
        return self.compute_metrics(self.mesh_statistics) | {
            "bricks": self.brick_count,
            "bricks_fused": self.fused_brick_count,
        }


def fuse_in_bricks(
    work: FusionJob,
    result: Path,
    *,
    brick_store: BrickStore | None = None,
    progress: Progress = ignore_progress,
) -> FusedInBricks:
    """Fuse frames brick by brick, and write a PLY file.

    Parameters
    ----------
    work : fusion of at least two frames.
    result : PLY file to write.
    brick_store : store for fused bricks, reused by later runs; None discards the bricks.
    progress : called after each frame of the first pass, and after each frame of each cube.

    Raises
    ------
    InputError, StageError
        As `fuse`; also StageError if a single brick exceeds the memory limit.
    """
    size, voxel_size = work.params.brick_size, work.plan.voxel_size
    # Chunks of the written mesh consist of whole bricks.
    max_level = compute_chunk_level(voxel_size)
    level = min(compute_level(size, voxel_size), max_level) if size else max_level
    index = _build_index(work, level, progress)
    with _open_brick_store(brick_store, result.parent) as brick_store:
        # Initial guess: a frame that touches a block observes about half of its voxels.
        min_weight = work.params.min_weight or derive_min_observations(index.median_frames / 2, work.frames)
        fused = _fuse_missing_bricks(work, index, level, brick_store, min_weight, progress)
        counts = sum(map(_read_counts, fused.folders), np.zeros(256, np.int64))
        actual_min_weight = work.params.min_weight or derive_min_observations(
            compute_histogram_median(counts), work.frames
        )
        if actual_min_weight != min_weight:
            min_weight = actual_min_weight
            fused = _fuse_missing_bricks(work, index, level, brick_store, min_weight, progress)
        outcomes = _merge_outcomes(work, index, fused)
        joined = StitchedMesh(fused.bricks, fused.folders)
        if not joined.triangle_count:
            raise make_empty_mesh_error(work, outcomes, min_weight)
        metrics = _write_mesh(work, joined, result)
    return FusedInBricks(
        path=result,
        mesh_statistics=metrics,
        brick_count=len(fused.bricks),
        fused_brick_count=fused.fused_count,
        **collect_statistics(work, outcomes, min_weight, fused.volume_bytes, "CPU:0"),
    )


@dataclass(frozen=True, eq=False)
class _BlockIndex:
    """Result of the first pass over all frames.

    Attributes
    ----------
    outcomes : outcome of each frame, from its depth alone.
    block_keys : sorted Z-order keys of all touched blocks.
    median_frames : number of frames that touch the median block.
    frames_by_brick : by Z-order index of a brick, indices of the frames that its surface may depend on.
    """

    outcomes: list[FrameOutcome]
    block_keys: BlockKeys
    median_frames: float
    frames_by_brick: Mapping[int, list[int]]


def _build_index(work: FusionJob, level: int, progress: Progress) -> _BlockIndex:
    seen, frames = TouchedBlockCounter(), defaultdict(list)

    def add_frame(number: int, keys: BlockKeys) -> None:
        seen.add(keys)
        for brick in find_affected_bricks(keys, level):
            frames[brick].append(number)

    outcomes = collect_touched_blocks(work, add_frame, progress)
    keys, times = seen.get_counts()
    return _BlockIndex(outcomes, keys, float(np.median(times)) if len(times) else 0.0, frames)


@dataclass
class _FusedBricks:
    """Bricks of a fusion.

    Attributes
    ----------
    bricks, folders : the bricks in Z-order, and the folders of their files.
    fused_count : number of bricks that were fused rather than reused.
    volume_bytes : peak memory of the volume.
    """

    bricks: list[BlockCube]
    folders: list[Path]
    fused_count: int
    volume_bytes: int


def _fuse_missing_bricks(
    work: FusionJob,
    index: _BlockIndex,
    level: int,
    brick_store: BrickStore,
    min_weight: int,
    progress: Progress,
) -> _FusedBricks:
    """Fuse the bricks missing from the store.

    As many bricks as fit in memory are fused at a time.
    """
    max_blocks = int(work.params.memory * 1e6 / compute_block_bytes(color=work.color))
    occupied_bricks = {int(number) for number in np.unique(index.block_keys >> np.uint64(3 * level))}
    inputs = _collect_brick_inputs(work, min_weight)
    fused = _FusedBricks([], [], 0, 0)
    for cube in split_into_passes(index.block_keys, level, max_blocks):
        bricks = select_bricks(cube, occupied_bricks, level)
        folders = {
            brick: brick_store.get(brick, index.frames_by_brick[brick.index], inputs) for brick in bricks
        }
        missing = [brick for brick, folder in folders.items() if folder is None]
        if missing:
            numbers = sorted({frame for brick in missing for frame in index.frames_by_brick[brick.index]})
            volume = create_volume(work, _bound_bricks(missing))
            outcomes = integrate_frames(work, volume, [work.frames[i] for i in numbers], progress)
            reasons = {
                number: one.diagnostic
                for number, one in zip(numbers, outcomes, strict=True)
                if isinstance(one, SkippedFrame)
            }
            fused.volume_bytes = max(fused.volume_bytes, volume.bytes)
            fused.fused_count += len(missing)
            for brick in missing:
                frames = index.frames_by_brick[brick.index]
                # Keyed by index within the frames of the brick: global frame indices may shift before the
                # brick is reused.
                skipped = {at: reasons[number] for at, number in enumerate(frames) if number in reasons}
                write = partial(_write_brick, volume, min_weight, brick, skipped)
                folders[brick] = brick_store.store(brick, frames, inputs, write)
        fused.bricks += bricks
        fused.folders += [folder for folder in folders.values() if folder is not None]
    return fused


def _collect_brick_inputs(work: FusionJob, min_weight: int) -> dict[str, Any]:
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
        "weighing": asdict(plan.noise_model),
        "origin": plan.origin.tolist(),
        "crop": asdict(plan.crop),
        "reach": plan.crop_margin,
        "color": work.color,
        "upsample": [params.upsample, work.upsampling_factor],
        "min_weight": min_weight,
    }


def _bound_bricks(bricks: Sequence[BlockCube]) -> BlockBox:
    """Return the bounding box of bricks, plus one block on each side."""
    x, y, z = np.min([brick.low for brick in bricks], axis=0) - 1
    right, top, back = np.max([brick.high for brick in bricks], axis=0) + 1
    return (int(x), int(y), int(z)), (int(right), int(top), int(back))


def _write_brick(
    volume: SparseVolume, min_weight: int, brick: BlockCube, skipped: Mapping[int, Diagnostic], folder: Path
) -> None:
    """Write the mesh, observation histogram and skipped frames of a brick."""
    within = brick.low, brick.high
    np.save(folder / _COUNTS_FILE, volume.count_observations(within))
    mesh, _, joints = volume.extract_brick_mesh(min_weight, within)
    write_brick_mesh(folder, BrickMesh(mesh.vertices, mesh.triangles, mesh.colors), joints)
    reasons = {at: diagnostic.to_dict() for at, diagnostic in skipped.items()}
    (folder / _SKIPPED_FILE).write_text(json.dumps(reasons) + "\n", encoding="utf-8", newline="\n")


def _read_counts(folder: Path) -> NDArray[np.int64]:
    with convert_read_errors(folder):
        return np.array(map_array(folder / _COUNTS_FILE), np.int64).reshape(256)


def _merge_outcomes(work: FusionJob, index: _BlockIndex, made: _FusedBricks) -> list[FrameOutcome]:
    """Return the outcome of every frame of the scan.

    A frame with readable depth is skipped if its colour turns out unreadable during the integration.
    """
    outcomes = list(index.outcomes)
    for brick, folder in zip(made.bricks, made.folders, strict=True):
        with convert_read_errors(folder):
            skipped = {
                int(at): Diagnostic.from_dict(metrics)
                for at, metrics in read_document(folder / _SKIPPED_FILE).items()
            }
        for at, diagnostic in skipped.items():
            number = index.frames_by_brick[brick.index][at]
            outcomes[number] = SkippedFrame(work.frames[number].name, diagnostic)
    check_skipped_ratio(work, outcomes)
    return outcomes


def _write_mesh(work: FusionJob, joined: StitchedMesh, result: Path) -> MeshStatistics:
    """Write the stitched mesh. A cropped mesh is assembled in memory first."""
    plan = work.plan
    if not plan.crop:
        return write_stitched_mesh(result, joined, plan, has_colors=work.color)
    mesh = joined.assemble_mesh()
    mesh = crop_mesh(mesh.with_(vertices=mesh.vertices + plan.origin), plan.crop)
    write_fused_mesh(result, mesh, plan)
    return MeshStatistics.from_mesh(mesh)


@dataclass(frozen=True, eq=False)
class _TemporaryBrickStore:
    """Temporary brick store for a single run; lookups always miss."""

    folder: Path

    def get(self, brick: BlockCube, frames: Sequence[int], inputs: Mapping[str, Any]) -> None:
        """Return None: every brick is fused again."""

    def store(
        self,
        brick: BlockCube,
        frames: Sequence[int],  # noqa: ARG002
        inputs: Mapping[str, Any],  # noqa: ARG002
        write_files: Callable[[Path], None],
    ) -> Path:
        """Write the files of a brick into a subfolder."""
        folder = self.folder / str(brick.index)
        folder.mkdir(exist_ok=True)
        write_files(folder)
        return folder


@contextmanager
def _open_brick_store(brick_store: BrickStore | None, parent_folder: Path) -> Iterator[BrickStore]:
    if brick_store is not None:
        yield brick_store
        return
    with tempfile.TemporaryDirectory(dir=parent_folder, prefix=".bricks-") as folder:
        yield _TemporaryBrickStore(Path(folder))
