"""SNM files: lossless round trips, coarser meshes from prefixes, and all kinds of damage."""

from __future__ import annotations

import functools
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import coloured_meshes
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from partial_meshes import select_quarter

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.diagnostics.errors import InputError, StageError, UsageError
from scanloom.stages.normal_meshes.normal_mesh import NormalMesh, decode
from scanloom.stages.normal_meshes.remesh import remesh
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.formats.ply import read_vertex_values
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.topology import topology

pytestmark = pytest.mark.slow

MANY = 2_000
SHARED = (
    "cow.obj",
    "horse.ply",
    "stanford-bunny.obj",
    "igea.ply",
    "fandisk.obj",
    "rocker-arm.obj",
    "face.obj",
    "camelhead.off",
    "colored_airplane.ply",
    "sceaux_mvs_scene_mesh.ply",
    "redkitchen_fused_vertexcolor.ply",
    "spot/spot_triangulated.obj",
    "bunny10k_textured",
    "fuze",
    "ycb_banana",
    "pirate.obj",
    "Duck.glb",
    "CesiumMilkTruck.glb",
)


def assert_equal(found: NormalMesh, expected: NormalMesh, levels: int) -> None:
    """Check that the first levels are identical, and that there are no more."""
    assert len(found.levels) == levels
    for one, other in zip(found.levels, expected.levels, strict=False):
        assert one.vertices.tobytes() == other.vertices.tobytes()
        assert one.triangles.tobytes() == other.triangles.tobytes()
        assert (one.colors is None) == (other.colors is None)
        if one.colors is not None:
            assert one.colors.tobytes() == other.colors.tobytes()
    assert (found.confidence is None) == (expected.confidence is None)
    for one, other in zip(found.confidence or (), expected.confidence or (), strict=False):
        assert one.tobytes() == other.tobytes()
    for one, other in zip(found.offsets, expected.offsets, strict=False):
        for name in ("kinds", "values", "predicted", "normals"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
    assert found.data == expected.data[: expected.level_ends[levels - 1]]
    assert found.level_ends == expected.level_ends[:levels]
    assert found.encoded_levels == expected.encoded_levels


@functools.cache
def make_small_mesh() -> NormalMesh:
    """Make a coloured sheet with two holes, confidence and three levels, in a file of a few kilobytes."""
    mesh = coloured_meshes.make_holed_sheet()
    return remesh(
        mesh, confidence=mesh.vertices[:, 0], levels=2, base_triangles=60, tolerance=1e-4, color_tolerance=4.0
    )


# -- round trips -----------------------------------------------------------------------------------------


@st.composite
def draw_meshes(draw: st.DrawFn) -> Mesh:
    """Draw sheets, tubes, rings and pairs of sheets with random bumps, colours and holes."""
    kind = draw(st.sampled_from(["sheet", "tube", "ring", "several"]))
    n, m = draw(st.integers(3, 14)), draw(st.integers(3, 14))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    v, u = (a.ravel() for a in np.mgrid[0:m, 0:n])
    around, along = kind in ("tube", "ring"), kind == "ring"
    if kind in ("sheet", "several"):
        places = np.stack([u, v, 0 * u], axis=1).astype(np.float64)
    else:
        angle, turn = 2 * np.pi * u / n, 2 * np.pi * v / m
        radius = 1 if kind == "tube" else 3 + np.cos(angle)
        places = np.stack([np.cos(angle), np.sin(angle), v / 2], axis=1)
        if kind == "ring":
            places = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sin(angle)], axis=1)
    places += draw(st.sampled_from([0.0, 0.05, 0.4])) * rng.normal(size=places.shape)
    columns = np.arange(n if around else n - 1)
    rows = np.arange(m if along else m - 1)
    right, up = (columns + 1) % n, (rows + 1) % m
    a, b = (n * rows[:, None] + columns).ravel(), (n * rows[:, None] + right).ravel()
    c, d = (n * up[:, None] + right).ravel(), (n * up[:, None] + columns).ravel()
    triangles = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3).astype(np.int32)
    if kind == "several":
        triangles = np.concatenate([triangles, triangles[:, ::-1] + len(places)]).astype(np.int32)
        places = np.concatenate([places, places + np.array((0.3, 0.1, 2.0))])
    kept = rng.random(len(triangles)) >= draw(st.sampled_from([0.0, 0.0, 0.1]))
    kept[0] = True
    colors = rng.integers(0, 256, (len(places), 3)).astype(np.uint8) if draw(st.booleans()) else None
    scale = draw(st.sampled_from([1e-3, 1.0, 1e4]))
    return Mesh(scale * places, triangles[kept], colors=colors)


@given(
    mesh=draw_meshes(),
    levels=st.integers(0, 3),
    base=st.sampled_from([None, 1, 30]),
    scheme=st.sampled_from(["linear", "butterfly"]),
    relaxations=st.integers(0, 4),
    tolerance=st.sampled_from([5e-8, 1e-5, 1e-3]),
    color_tolerance=st.sampled_from([0.0, 2.0, 20.0]),
    with_confidence=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_a_normal_mesh_is_decoded_as_made(
    mesh: Mesh,
    levels: int,
    base: int | None,
    scheme: str,
    relaxations: int,
    tolerance: float,
    color_tolerance: float,
    with_confidence: bool,
) -> None:
    made = remesh(
        mesh,
        confidence=mesh.vertices[:, 0] if with_confidence else None,
        levels=levels,
        base_triangles=base,
        scheme=scheme,
        relaxations=relaxations,
        tolerance=tolerance,
        color_tolerance=color_tolerance,
    )
    for level in made.levels:
        assert np.isfinite(level.vertices).all()
        assert topology(level).is_manifold
    for level in range(levels + 1):
        assert_equal(decode(made.data[: made.level_ends[level]]), made, level + 1)
        assert_equal(decode(made.data, level), made, level + 1)
    decoded = decode(made.data)
    assert decoded.damage is None
    assert decoded.base_source is None
    assert decoded.triangle_source is None


def compute_digests(found: NormalMesh) -> list[str]:
    return [
        hashlib.sha256(
            level.vertices.tobytes()
            + level.triangles.tobytes()
            + (b"" if level.colors is None else level.colors.tobytes())
        ).hexdigest()
        for level in found.levels
    ]


DECODE_IN_ANOTHER = """
import hashlib, json, sys
from scanloom.stages import decode
print(json.dumps([
    hashlib.sha256(
        level.vertices.tobytes() + level.triangles.tobytes()
        + (b"" if level.colors is None else level.colors.tobytes())
    ).hexdigest()
    for level in decode(sys.argv[1]).levels
]))
"""


@pytest.mark.parametrize("name", SHARED)
def test_shared_meshes_are_decoded_exactly_in_another_process(
    shared_data: Path, tmp_path: Path, name: str
) -> None:
    path = shared_data / "meshes" / name
    if path.is_dir():
        path = next(one for one in sorted(path.iterdir()) if one.suffix in (".obj", ".ply"))
    mesh = read_mesh(path)
    if "kitchen" in name:
        mesh = select_quarter(mesh)
    if topology(mesh).inconsistent_edges or topology(mesh).nonmanifold_edges:
        mesh = clean(mesh).mesh
    if len(mesh.triangles) > MANY:
        # The test covers the coder, so the base may be small.
        mesh = simplify(mesh, triangles=MANY).mesh
    made = remesh(mesh, levels=3)
    file = tmp_path / "made.snm"
    made.save(file)
    done = subprocess.run(
        [sys.executable, "-c", DECODE_IN_ANOTHER, file], capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout) == compute_digests(made)
    for level in range(4):
        assert_equal(decode(file, level), made, level + 1)


# -- prefixes --------------------------------------------------------------------------------------------


def test_a_prefix_of_a_file_is_a_coarser_mesh(tmp_path: Path) -> None:
    made = make_small_mesh()
    for level in range(3):
        path = tmp_path / f"{level}.snm"
        made.save(path, level)
        assert path.stat().st_size == made.level_ends[level]
        found = decode(path)
        assert_equal(found, made, level + 1)
        assert found.damage is None
        assert found.encoded_levels == 2
    assert path.read_bytes() == made.data


def test_a_truncated_file_gives_its_intact_levels() -> None:
    made = make_small_mesh()
    for size in range(len(made.data)):
        whole = sum(end <= size for end in made.level_ends)
        if whole == 0:
            with pytest.raises(InputError):
                decode(made.data[:size])
            continue
        found = decode(made.data[:size])
        assert_equal(found, made, whole)
        assert (found.damage is None) == (size in made.level_ends)


def test_missing_levels_are_reported() -> None:
    made = make_small_mesh()
    with pytest.raises(UsageError, match="level is 3, but data was encoded with levels 0 to 2"):
        decode(made.data, 3)
    with pytest.raises(UsageError, match="level is -1"):
        decode(made.data, -1)
    cut = made.data[: made.level_ends[1] + 5]
    assert_equal(decode(cut, 1), made, 2)
    with pytest.raises(InputError, match="has no level 2; only levels 0 to 1 are intact"):
        decode(cut, 2)
    with pytest.raises(InputError, match=r"has no level 2.*the file ends there"):
        decode(made.data[: made.level_ends[1]], 2)
    with pytest.raises(UsageError, match="only levels 0 to 1"):
        decode(cut).save("never.snm", 2)


# -- damage ----------------------------------------------------------------------------------------------


def test_any_changed_byte_is_detected() -> None:
    """The returned levels do not contain the changed byte."""
    made = make_small_mesh()
    for at in range(len(made.data)):
        for mask in (0x01, 0x80, 0xFF):
            data = bytearray(made.data)
            data[at] ^= mask
            whole = sum(end <= at for end in made.level_ends)
            try:
                found = decode(bytes(data))
            except InputError:
                assert whole == 0
                continue
            assert found.damage is not None
            assert whole > 0
            assert_equal(found, made, whole)


@given(data=st.data())
@settings(max_examples=300, deadline=None)
def test_changed_added_or_lost_bytes_never_crash(data: st.DataObject) -> None:
    made = make_small_mesh().data
    damaged = bytearray(made)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, max(len(damaged) - 1, 0)))
        what = data.draw(st.sampled_from(["change", "lose", "add", "double"]))
        some = data.draw(st.binary(min_size=1, max_size=12))
        if what == "change":
            damaged[at : at + len(some)] = some
        elif what == "lose":
            del damaged[at : at + len(some)]
        elif what == "add":
            damaged[at:at] = some
        else:
            damaged += damaged[at:]
    try:
        found = decode(bytes(damaged))
    except InputError:
        return
    for level in found.levels:
        assert np.isfinite(level.vertices).all()
        assert level.triangles.max() < len(level.vertices)


@given(start=st.binary(max_size=64), keep=st.integers(0, 12))
@settings(max_examples=300, deadline=None)
def test_random_bytes_are_not_a_file(start: bytes, keep: int) -> None:
    try:
        found = decode(make_small_mesh().data[:keep] + start)
    except InputError:
        return
    assert len(found.mesh.vertices) < 1000


DECODE_ALL_DAMAGED = """
import resource, sys
from scanloom.stages import InputError, decode
made = open(sys.argv[1], "rb").read()
decode(made)
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 256_000_000,) * 2)
for at in range(0, min(len(made), 400)):
    for value in (0x00, 0x7F, 0x80, 0xFF):
        for tail in (made[at + 1 :], bytes([value]) * 16):
            try:
                decode(made[:at] + bytes([value]) + tail)
            except InputError:
                pass
print("alive")
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads the size of the process from /proc")
def test_a_damaged_file_allocates_little_memory(tmp_path: Path) -> None:
    """Decoding needs at most 256 MB, whatever sizes the damaged file states."""
    make_small_mesh().save(tmp_path / "small.snm")
    done = subprocess.run(
        [sys.executable, "-c", DECODE_ALL_DAMAGED, tmp_path / "small.snm"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.stdout.strip() == "alive", done.stderr


@pytest.mark.parametrize("data", [b"", b"ply\n", b"\x00" * 100, b"PK\x03\x04" + bytes(60)])
def test_other_files_are_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "other.snm"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"other\.snm: .*\.$"):
        decode(path)


@pytest.mark.parametrize(("version", "words"), [(0, "version 0 of"), (2, "damaged"), (3, "version 3 of")])
def test_other_versions_are_refused(version: int, words: str) -> None:
    made = bytearray(make_small_mesh().data)
    assert made[3] == 1
    made[3] = version
    with pytest.raises(InputError, match=words):
        decode(bytes(made))


@pytest.mark.parametrize(
    "up", [(0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.004913, -0.8944, -0.4472), (3.0, 4.0, 0.0)]
)
def test_the_up_direction_is_stored_exactly_for_every_level(up: tuple[float, float, float]) -> None:
    plain, up = make_small_mesh(), tuple(np.divide(up, np.linalg.norm(up)).tolist())
    mesh = coloured_meshes.sheet(12).with_(up=up)
    files = [remesh(mesh, levels=2, base_triangles=20, threads=threads) for threads in (1, 2)]
    assert files[0].data == files[1].data
    assert files[0].data[:4] == b"snm\2"
    for end in files[0].level_ends:
        found = decode(files[0].data[:end])
        assert all(level.up == up for level in found.levels)
    assert all(level.up == up for level in files[0].levels)
    assert all(level.up is None for level in decode(plain.data).levels)
    without = remesh(mesh.with_(up=None), levels=2, base_triangles=20)
    assert without.data[:4] == b"snm\1"
    assert len(files[0].data) <= len(without.data) + (1 if max(map(abs, up)) == 1 else 25)
    for one, other in zip(files[0].levels, without.levels, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)


def test_a_missing_file_or_a_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.snm: cannot be read"):
        decode(tmp_path / "none.snm")
    with pytest.raises(InputError, match="cannot be read"):
        decode(tmp_path)
    with pytest.raises(StageError, match="cannot be written"):
        make_small_mesh().save(tmp_path / "no" / "folder.snm")


# -- meshes of levels ------------------------------------------------------------------------------------


def test_levels_are_written_as_ply_with_their_confidence(tmp_path: Path) -> None:
    made = make_small_mesh()
    paths = made.write_levels(tmp_path / "levels")
    assert [path.name for path in paths] == ["level_0.ply", "level_1.ply", "level_2.ply"]
    made.write(tmp_path / "finest.ply")
    assert (tmp_path / "finest.ply").read_bytes() == paths[2].read_bytes()
    for path, level, confidence in zip(paths, made.levels, made.confidence, strict=True):
        back = read_mesh(path)
        for name in ("vertices", "triangles", "colors"):
            np.testing.assert_array_equal(getattr(back, name), getattr(level, name))
        np.testing.assert_array_equal(read_vertex_values(path, "confidence"), confidence)
    made.write(tmp_path / "coarse.off", 1)
    assert len(read_mesh(tmp_path / "coarse.off").triangles) == len(made.levels[1].triangles)
    with pytest.raises(UsageError, match="meshes are written as"):
        made.write(tmp_path / "mesh.xyz")
