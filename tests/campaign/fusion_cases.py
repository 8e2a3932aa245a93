"""Random depth maps through the kernels of fusion, and rules for the volume and its surface."""

from __future__ import annotations

import random
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.fusion.brick_stitching import BrickMesh, StitchedMesh, write_brick_mesh
from scanloom.stages.fusion.bricks import BlockCube, decode_z_order
from scanloom.stages.fusion.tsdf_volume import BLOCK_SIDE, BlockBox, BlockKeys
from tests.campaign.kernel_rules import assert_manifold
from tests.campaign.random_views import Shot, make_random_shots

# Limits so that a case takes at most a second; the result states what was skipped.
_MOST_BLOCKS, _MOST_BRICKS = 1500, 40


def run_fusion_case(seed: int) -> str:
    """Run the case of a seed and describe the result.

    Raises
    ------
    StageError
        If points are too far away to be addressed.
    AssertionError
        If a rule is broken.
    """
    draw = random.Random(seed)
    size = draw.choice((1.0, 1.0, 1.0, 2.0**-10, 2.0**10))
    shots = make_random_shots(draw, size)
    voxel_size = size * draw.choice((0.01, 0.03, 0.05, 0.08, 0.5))
    truncation = voxel_size * draw.choice((0.5, 1.0, 3.0, 3.0, 3.0, 8.0))
    field = _ShotFusion(shots, voxel_size, truncation, draw)
    if not 0 < field.count <= _MOST_BLOCKS:
        return f"{field.count} blocks"
    threads = draw.choice((2, 3, 5))
    whole = field.fuse(threads=1)
    for name in _kernels.Volume.supported_instructions():
        _assert_same(whole.copy_voxels(), field.fuse(threads=threads, instructions=name).copy_voxels(), name)
    _assert_voxels(*whole.copy_voxels())
    least = draw.choice((0, 1, 1, 1, 1, 2, 300))
    surface, _ = whole.extract_surface(least, within=None, wanted_threads=1)
    _assert_same(surface, whole.extract_surface(least, within=None, wanted_threads=threads)[0], "threads")
    _assert_surface(whole, surface, max(least, 1), truncation / voxel_size)
    message = _compare_bricks(field, surface, least, draw)
    _assert_respects_limit(field, draw)
    return f"{field.count} blocks, {len(surface[1])} triangles, {message}"


class _ShotFusion:
    """Shots, prepared for integration into a volume."""

    def __init__(
        self, shots: Sequence[Shot], voxel_size: float, truncation: float, draw: random.Random
    ) -> None:
        self._voxel_size = voxel_size
        self._truncation = truncation
        self._shots = shots
        self._color = draw.random() < 0.7
        noise = draw.choice((1.0, 1e-2, 1e-4))
        self._weighing = (noise, noise * draw.choice((0.0, 0.5, 1.0)), noise * draw.choice((0.0, 0.5, 1e6)))
        limits = (0.0, draw.choice((3.0, 1e38)), draw.choice((0.05, 1e9)), draw.choice((0.1, 0.0)))
        self._views = [_filter_depth(shot, limits, draw) for shot in shots]
        self.keys = [
            self._find_touched(shot, view, draw) for shot, view in zip(shots, self._views, strict=True)
        ]
        self.count = len(np.unique(np.concatenate(self.keys)))

    def fuse(
        self,
        *,
        threads: int,
        instructions: str | None = None,
        within: BlockBox | None = None,
        most: int = 1 << 20,
    ) -> _kernels.Volume:
        """Fuse the shots; with `within`, only the blocks of a box."""
        volume = _kernels.Volume(
            self._voxel_size,
            self._truncation,
            color=self._color,
            max_blocks=most,
            instructions=instructions,
        )
        for shot, (depth, _, obliqueness), keys in zip(self._shots, self._views, self.keys, strict=True):
            volume.integrate(
                keys if within is None else keys[_is_within(keys, within)],
                (shot.pinhole, shot.pose),
                depth,
                obliqueness,
                shot.color if self._color else None,
                weighing=self._weighing,
                wanted_threads=threads,
            )
        return volume

    def _find_touched(self, shot: Shot, view: Any, draw: random.Random) -> BlockKeys:
        depth, normal, obliqueness = view

        def find_blocks(within: BlockBox | None) -> BlockKeys:
            return _kernels.find_touched_blocks(
                (shot.pinhole, shot.pose),
                depth,
                normal,
                obliqueness,
                shot.wanted,
                voxel_size=self._voxel_size,
                truncation=self._truncation,
                within=within,
            )

        try:
            keys = find_blocks(None)
        except _kernels.LimitError as error:
            raise StageError(MACHINE_BUG, "a frame contains points too far away") from error
        assert (np.diff(keys.astype(np.float64)) >= 0).all(), "blocks are not sorted"
        assert len(np.unique(keys)) == len(keys), "a block is listed twice"
        if len(keys):
            low = decode_z_order(keys).min(axis=0) + draw.randrange(-1, 3)
            box = _make_box(low, low + draw.randrange(0, 6))
            _assert_same((keys[_is_within(keys, box)],), (find_blocks(box),), "a box")
        return keys


def _filter_depth(shot: Shot, limits: tuple[float, float, float, float], draw: random.Random) -> Any:
    one, other = (
        _kernels.filter_depth(shot.depth, shot.pinhole, limits=limits, wanted_threads=threads)
        for threads in (1, draw.choice((2, 3, 7)))
    )
    depth, normal, obliqueness = one
    _assert_same((depth, *normal, obliqueness), (other[0], *other[1], other[2]), "threads")
    is_there = depth > 0
    assert (np.isfinite(depth) & (depth <= limits[1]))[is_there].all(), "depth beyond its limits"
    assert not np.isnan(depth).any(), "a missing depth is NaN"
    assert (obliqueness >= 0.999 / shot.compute_ray_lengths())[is_there].all(), (
        "obliqueness is below the minimum along the ray"
    )
    return one


def _assert_voxels(
    blocks: NDArray[np.int32],
    distances: NDArray[np.float32],
    weights: NDArray[np.uint16],
    frames: NDArray[np.uint8],
    colors: NDArray[np.float32] | None,
) -> None:
    is_seen = weights > 0
    assert len(np.unique(blocks, axis=0)) == len(blocks), "a block is stored twice"
    assert (np.isnan(distances) == ~is_seen).all(), "distance and weight of a voxel disagree"
    assert (np.abs(distances[is_seen]) <= 1 + 1e-5).all(), "a distance beyond one truncation"
    assert (frames[~is_seen] == 0).all(), "a voxel without weight has observations"
    assert colors is None or ((colors >= 0) & (colors < 256)).all(), "a colour is out of range"


def _assert_surface(volume: _kernels.Volume, surface: Any, least: int, truncation: float) -> None:
    """Check that each vertex is at the zero crossing of an edge between two voxels."""
    places, triangles, colors, seen = surface
    assert np.isfinite(places).all(), "a vertex is not finite"
    assert ((colors >= 0) & (colors <= 255)).all(), "a colour is out of range"
    assert ((seen >= min(least, 255)) & (seen <= 255)).all(), "the observation count is below the minimum"
    assert_manifold(triangles, len(places))
    blocks, distances, _, frames, _ = volume.copy_voxels()
    values = np.where(frames >= min(least, 255), distances, np.nan) * np.float32(truncation)
    below = np.floor(places).astype(np.int64)
    share = places - below
    assert ((share > 0).sum(axis=1) == 1).all(), "a vertex is not on an edge"
    above = below + (share > 0)
    here, there = _get_voxels(blocks, values, below), _get_voxels(blocks, values, above)
    assert ((here < 0) != (there < 0)).all(), "a vertex is between voxels on the same side"
    assert not (np.isnan(here) | np.isnan(there)).any(), "a vertex is next to an unobserved voxel"
    expected = np.clip(here / (here - there), 1e-3, 1 - 1e-3)
    assert np.abs(share.max(axis=1, initial=0) - expected).max(initial=0) < 1e-5, (
        "a vertex is not at the zero crossing"
    )


def _get_voxels(
    blocks: NDArray[np.int32], values: NDArray[np.float32], voxels: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Get the values of voxels (n, 3)."""
    slots = {tuple(block): slot for slot, block in enumerate(blocks.tolist())}
    at = [slots[tuple(block)] for block in (voxels // BLOCK_SIDE).tolist()]
    within = voxels % BLOCK_SIDE @ np.array([1, BLOCK_SIDE, BLOCK_SIDE**2])
    return values[np.array(at, np.int64), within].astype(np.float64)


def _compare_bricks(field: _ShotFusion, surface: Any, least: int, draw: random.Random) -> str:
    """Fuse brick by brick, each with a rim of blocks, and compare the stitched mesh with the whole."""
    level = draw.choice((1, 1, 2, 3))
    keys = np.unique(np.concatenate(field.keys))
    cubes = [BlockCube(level, int(number)) for number in np.unique(keys >> np.uint64(3 * level))]
    if len(cubes) > _MOST_BRICKS:
        return f"{len(cubes)} bricks are too many"
    with tempfile.TemporaryDirectory() as made:
        folders = []
        for cube in cubes:
            box: BlockBox = (cube.low, cube.high)
            rim = _make_box(np.array(cube.low) - 1, np.array(cube.high) + 1)
            volume = field.fuse(threads=1, within=rim)
            (places, triangles, colors, _), joints = volume.extract_surface(
                least, within=box, wanted_threads=2
            )
            folders.append(Path(made) / f"{cube.index}")
            folders[-1].mkdir()
            write_brick_mesh(
                folders[-1], BrickMesh(places, triangles, np.rint(colors).astype(np.uint8)), joints
            )
        joined = StitchedMesh(cubes, folders)
        if joined.triangle_count == 0:
            assert len(surface[1]) == 0, "bricks have no surface, but the whole has one"
            return f"{len(cubes)} bricks"
        mesh = joined.assemble_mesh()
    whole = surface[0], surface[1], np.rint(surface[2]).astype(np.uint8)
    _assert_same(whole, (mesh.vertices, mesh.triangles, mesh.colors), "bricks")
    return f"{len(cubes)} bricks"


def _assert_respects_limit(field: _ShotFusion, draw: random.Random) -> None:
    """Check that a volume refuses more blocks than its limit."""
    most = draw.randrange(field.count)
    try:
        field.fuse(threads=1, most=most)
    except _kernels.LimitError:
        return
    raise AssertionError(f"{field.count} blocks above the limit of {most}")


def _is_within(keys: BlockKeys, box: BlockBox) -> NDArray[np.bool_]:
    at = decode_z_order(keys)
    return np.asarray(((at >= box[0]) & (at < box[1])).all(axis=1))


def _make_box(low: NDArray[Any], high: NDArray[Any]) -> BlockBox:
    (a, b, c), (d, e, f) = low.tolist(), high.tolist()
    return (a, b, c), (d, e, f)


def _assert_same(one: Sequence[Any], other: Sequence[Any], what: str) -> None:
    for a, b in zip(one, other, strict=True):
        assert (a is None) == (b is None), f"{what}: one value is missing"
        if a is not None:
            assert (a.shape, a.dtype, a.tobytes()) == (b.shape, b.dtype, b.tobytes()), (
                f"{what}: different bytes"
            )
