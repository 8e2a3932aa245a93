"""Fusion in bricks: for any bricks, the mesh is byte-identical to the mesh of in-memory fusion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chunked_sample import use_small_chunks
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError, StageError, UsageError
from scanloom.stages.fusion.brick_fusion import FusedInBricks, fuse_in_bricks
from scanloom.stages.fusion.bricks import (
    BlockCube,
    TouchedBlockCounter,
    compute_level,
    decode_z_order,
    encode_z_order,
    find_affected_bricks,
    split_into_passes,
)
from scanloom.stages.fusion.fuse import fuse, fuse_to_file
from scanloom.stages.fusion.integration import prepare_fusion
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.chunked_ply import ChunkedPly
from scanloom.stages.surface.formats.ply import read_ply, write_ply
from scanloom.stages.surface.topology import topology

SAMPLE = Path(__file__).resolve().parents[3] / "samples" / "rgbd"


@pytest.fixture(scope="module")
def scan() -> Scan:
    """Read every third frame of the sample."""
    whole = read_scan(SAMPLE)
    return replace(whole, frames=whole.frames[::3])


@pytest.fixture(scope="module")
def fused_in_memory(scan: Scan, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "fused.ply"
    write_ply(path, fuse(scan, voxel_size=0.01).mesh)
    return path.read_bytes()


def draw_blocks(seed: int, reach: int, count: int) -> NDArray[np.int64]:
    return np.random.default_rng(seed).integers(-reach, reach, (count, 3))


def test_the_brick_size_is_rounded_to_a_power_of_two() -> None:
    assert [compute_level(size, 0.01) for size in (4.0, 2.0, 0.2, 0.001)] == [6, 5, 1, 1]


def test_z_order_keys_and_positions_are_inverse() -> None:
    blocks = draw_blocks(0, 1 << 19, 1000)
    assert (decode_z_order(encode_z_order(blocks, 0)) == blocks).all()
    for block, number in zip(blocks >> 3, encode_z_order(blocks >> 3, 3), strict=True):
        low = np.array(BlockCube(3, int(number)).low)
        assert (low == block * 8).all()


@pytest.mark.parametrize("level", [1, 2, 4])
def test_a_frame_affects_touched_and_neighbouring_bricks(level: int) -> None:
    blocks = draw_blocks(1, 40, 30)
    found = find_affected_bricks(encode_z_order(blocks, 0), level)
    around = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    beside = (blocks[:, None] + around).reshape(-1, 3)
    assert found == sorted({int(number) for number in encode_z_order(beside >> level, level)})


def test_each_block_is_in_exactly_one_cube_within_the_limit() -> None:
    blocks = np.unique(draw_blocks(2, 30, 400), axis=0)
    keys = np.sort(encode_z_order(blocks, 0))
    cubes = split_into_passes(keys, 1, 40)
    assert len(cubes) > 20
    numbers = [np.unique(keys[(keys >> np.uint64(3 * cube.level)) == cube.index]) for cube in cubes]
    assert (np.concatenate(numbers) == keys).all()
    for cube in cubes:
        near = (blocks >= np.array(cube.low) - 1) & (blocks <= np.array(cube.high))
        assert cube.level == 1 or near.all(axis=1).sum() <= 40
    assert len(split_into_passes(keys, 1, 10_000)) == 1


@pytest.mark.parametrize(("size", "memory"), [(0.16, 4000), (0.3, 2), (0.7, 1.2)])
def test_bricks_give_the_bytes_of_in_memory_fusion(
    scan: Scan, fused_in_memory: bytes, size: float, memory: float, tmp_path: Path
) -> None:
    params = FuseParams(voxel_size=0.01, brick_size=size, memory=memory)
    found = fuse_to_file(scan, params, tmp_path / "fused.ply")
    assert isinstance(found, FusedInBricks)
    assert found.brick_count == found.fused_brick_count > 1
    assert found.volume_bytes <= memory * 1e6
    assert (tmp_path / "fused.ply").read_bytes() == fused_in_memory
    assert [path.name for path in tmp_path.iterdir()] == ["fused.ply"]


@pytest.mark.slow
@pytest.mark.parametrize("crop", [{}, {"radius": 0.3, "center": (0.1, -0.1, 0.1)}])
def test_chunks_of_a_large_mesh_do_not_depend_on_bricks(
    scan: Scan, crop: dict[str, Any], tmp_path: Path
) -> None:
    ways: dict[str, dict[str, Any]] = {"one": {}, "small": {"brick_size": 0.08}, "tight": {"memory": 1.5}}
    with use_small_chunks():
        for way, params in ways.items():
            fuse_to_file(scan, FuseParams(voxel_size=0.01, **crop, **params), tmp_path / f"{way}.ply")
    tables = {way: (tmp_path / f"{way}.pieces.json").read_bytes() for way in ways}
    assert tables["one"] == tables["small"] == tables["tight"]
    pieces = ChunkedPly(tmp_path / "one.ply")
    assert len(pieces) > 8
    whole = read_ply(tmp_path / "one.ply")
    assert pieces.triangle_count == len(whole.triangles)
    for number, extent in enumerate(pieces.extents):
        part = pieces.read_chunk(number)
        places = part.mesh.vertices[: part.own_count]
        # Each owned vertex is in the box, or on an edge that leads out of the box.
        assert ((places >= np.array(extent.low) - 1e-9) & (places < np.array(extent.high))).all()


def test_the_fused_surface_is_manifold(fused_in_memory: bytes, tmp_path: Path) -> None:
    (tmp_path / "fused.ply").write_bytes(fused_in_memory)
    found = topology(read_ply(tmp_path / "fused.ply"))
    assert found.is_manifold
    assert found.is_oriented


def test_fusion_beyond_the_memory_limit_uses_bricks_automatically(
    scan: Scan, fused_in_memory: bytes, tmp_path: Path
) -> None:
    write_ply(tmp_path / "fused.ply", fuse(scan, voxel_size=0.01, memory=1.2).mesh)
    assert (tmp_path / "fused.ply").read_bytes() == fused_in_memory


def test_a_brick_beyond_the_memory_limit_is_an_error(scan: Scan) -> None:
    with pytest.raises(StageError, match="exceed its memory limit of 1 MB"):
        fuse(scan, voxel_size=0.004, brick_size=4.0, memory=1)


def test_bricks_need_the_own_backend(scan: Scan) -> None:
    with pytest.raises(UsageError, match="brick_size"):
        fuse(scan, brick_size=1.0, backend="open3d")


def test_a_crop_in_bricks_equals_a_crop_in_memory(scan: Scan) -> None:
    crop: dict[str, Any] = {"voxel_size": 0.01, "radius": 0.2, "center": (0.1, -0.1, 0.1)}
    whole, joined = fuse(scan, **crop).mesh, fuse(scan, brick_size=0.16, **crop).mesh
    assert (whole.vertices == joined.vertices).all()
    assert (whole.triangles == joined.triangles).all()


def test_an_unreadable_frame_is_skipped_in_bricks(scan: Scan, tmp_path: Path) -> None:
    (tmp_path / "bad.jpg").write_bytes(b"no picture")
    frames = [*scan.frames]
    frames[3] = replace(frames[3], color=tmp_path / "bad.jpg")
    broken = replace(scan, frames=frames)
    whole, joined = fuse(broken, voxel_size=0.02), fuse(broken, voxel_size=0.02, brick_size=0.3)
    assert [one.name for one in joined.skipped] == [frames[3].name]
    assert (whole.mesh.vertices == joined.mesh.vertices).all()
    assert whole.frames == joined.frames
    with pytest.raises(InputError, match="max_skipped_ratio allows 0%"):
        fuse(broken, voxel_size=0.02, brick_size=0.3, max_skipped_ratio=0)


def test_a_wrong_guess_of_the_minimum_observation_count_is_corrected(
    scan: Scan, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = fuse(scan, voxel_size=0.02)
    assert whole.min_weight > 1
    monkeypatch.setattr(
        TouchedBlockCounter,
        "get_counts",
        lambda seen, look=TouchedBlockCounter.get_counts: (look(seen)[0], look(seen)[1] * 0 + 1),
    )
    joined = fuse(scan, voxel_size=0.02, brick_size=0.6)
    assert joined.min_weight == whole.min_weight
    assert (whole.mesh.vertices == joined.mesh.vertices).all()


class FolderBrickStore:
    """Brick store in a folder, with the brick, its frames and the decisions as key."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.count = 0
        self.places: dict[str, Path] = {}

    def get(self, brick: BlockCube, frames: Sequence[int], decided: Mapping[str, Any]) -> Path | None:
        return self.places.get(repr((brick, list(frames), decided)))

    def store(
        self,
        brick: BlockCube,
        frames: Sequence[int],
        decided: Mapping[str, Any],
        make: Callable[[Path], None],
    ) -> Path:
        self.count += 1
        folder = self.folder / f"{self.count}"
        folder.mkdir()
        make(folder)
        self.places[repr((brick, list(frames), decided))] = folder
        return folder


@pytest.mark.slow
def test_cached_bricks_are_not_fused_again(scan: Scan, fused_in_memory: bytes, tmp_path: Path) -> None:
    kept = FolderBrickStore(tmp_path)
    params = FuseParams(voxel_size=0.01, brick_size=0.3, memory=2)

    def again() -> FusedInBricks:
        return fuse_in_bricks(prepare_fusion(scan, params), tmp_path / "fused.ply", brick_store=kept)

    first = again()
    assert again().fused_brick_count == 0
    assert (tmp_path / "fused.ply").read_bytes() == fused_in_memory
    # After a killed run: existing bricks are used, the rest is fused.
    for name in list(kept.places)[::3]:
        del kept.places[name]
    assert 0 < again().fused_brick_count < first.fused_brick_count
    assert (tmp_path / "fused.ply").read_bytes() == fused_in_memory


def test_frames_skipped_for_their_colours_are_reported_from_cached_bricks(scan: Scan, tmp_path: Path) -> None:
    (tmp_path / "bad.jpg").write_bytes(b"no picture")
    frames = [*scan.frames]
    frames[3] = replace(frames[3], color=tmp_path / "bad.jpg")
    work = prepare_fusion(replace(scan, frames=frames), FuseParams(voxel_size=0.02, brick_size=0.3))
    kept = FolderBrickStore(tmp_path)
    first, again = (fuse_in_bricks(work, tmp_path / "fused.ply", brick_store=kept) for _ in range(2))
    assert again.fused_brick_count == 0
    assert [one.name for one in first.skipped] == [one.name for one in again.skipped] == [frames[3].name]
    assert first.to_dict() == again.to_dict() | {
        "bricks_fused": first.fused_brick_count,
        "volume_mb": first.volume_bytes / 1e6,
    }


@pytest.mark.slow
def test_a_real_kitchen_in_bricks_equals_in_memory_fusion(shared_data: Path, tmp_path: Path) -> None:
    kitchen = read_scan(shared_data / "rgbd" / "7scenes_redkitchen")
    every_fifth = replace(kitchen, frames=kitchen.frames[::5])
    for name, params in {"whole": {}, "bricks": {"brick_size": 1.0, "memory": 10}}.items():
        fuse_to_file(every_fifth, FuseParams(voxel_size=0.02, **params), tmp_path / f"{name}.ply")
    assert (tmp_path / "bricks.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
