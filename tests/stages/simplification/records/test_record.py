"""The record of collapses: every mesh on the way is whole, the last is the result, a file holds it all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from stages.cleaning.clean import clean
from stages.comparing.compare import compare
from stages.errors import InputError, StageError, UsageError
from stages.simplification.records.record import CollapseRecord, Replayed, load_record
from stages.simplification.simplify import Simplified, simplify
from stages.surface.mesh import Mesh
from stages.surface.mesh_files import read_mesh
from stages.surface.topology import topology


def ring() -> Mesh:
    made = trimesh.creation.torus(1.0, 0.4, major_sections=48, minor_sections=24)
    vertices = np.array(made.vertices)
    colors = np.clip(128 + 90 * np.sin(5 * vertices), 0, 255).astype(np.uint8)
    return Mesh(vertices, np.array(made.faces, np.int32), colors=colors)


def half_ring() -> Mesh:
    """Open at both ends."""
    mesh = ring()
    kept = mesh.triangles[(mesh.vertices[mesh.triangles][:, :, 1] > 0.1).all(axis=1)]
    return clean(mesh.with_(triangles=kept)).mesh


MESHES = {"ring": ring, "half ring": half_ring}


def recorded(mesh: Mesh, **changes: Any) -> tuple[Simplified, CollapseRecord]:
    result = simplify(mesh, record=True, **changes)
    assert result.record is not None
    return result, result.record


def assert_equal(one: Simplified | Replayed, other: Simplified | Replayed) -> None:
    for name in ("vertices", "triangles", "colors", "normals"):
        np.testing.assert_array_equal(getattr(one.mesh, name), getattr(other.mesh, name))
    np.testing.assert_array_equal(one.vertex_source, other.vertex_source)
    np.testing.assert_array_equal(one.triangle_source, other.triangle_source)


# -- replay ----------------------------------------------------------------------------------------------


BOUNDED = {
    "certified": {"max_shape": 0.02, "max_texture": 20},
    "certified to a number": {"max_shape": 0.05, "triangles": 500},
    "jia01": {"method": "jia01", "max_shape": 0.03},
    "jia01 with splits": {"method": "jia01", "max_shape": 0.03, "resolution": 0.07},
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("fit", [True, False], ids=["fitted", "plain"])
def test_the_whole_record_gives_the_result(name: str, fit: bool) -> None:
    result, record = recorded(MESHES[name](), ratio=0.1, fit=fit)
    assert len(record.removed) == result.collapses
    assert_equal(record.replay(fit=fit), result)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("how", BOUNDED)
def test_the_whole_record_gives_the_result_within_bounds(name: str, how: str) -> None:
    result, record = recorded(MESHES[name](), **BOUNDED[how])
    assert len(record.removed) == result.collapses > 150
    assert (result.splits > 0) == (how == "jia01 with splits")
    assert_equal(record.replay(), result)


def test_no_collapse_gives_the_input() -> None:
    mesh = ring()
    _, record = recorded(mesh, ratio=0.1)
    assert_equal(record.replay(collapses=0), recorded(mesh, ratio=1.0)[0])
    np.testing.assert_array_equal(record.replay(collapses=0).mesh.vertices, mesh.vertices)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("how", ["quadric", *BOUNDED])
def test_every_mesh_on_the_way_is_whole(name: str, how: str) -> None:
    _, record = recorded(MESHES[name](), **BOUNDED.get(how, {"triangles": 1}))
    was = topology(record.mesh)
    assert len(record.removed) > (300 if how == "quadric" else 150)
    triangles = len(record.mesh.triangles)
    step = max(7, len(record.removed) // 60)
    for collapses in range(0, len(record.removed) + 1, step):
        replayed = record.replay(collapses=collapses)
        now = topology(replayed.mesh)
        assert now.is_manifold
        assert now.is_oriented
        assert (now.euler, now.boundary_loops, now.components) == (
            was.euler,
            was.boundary_loops,
            was.components,
        )
        assert now.duplicate == now.unreferenced == 0
        # A collapse removes one vertex and two triangles, or one triangle at a boundary.
        assert now.vertices == was.vertices - collapses
        assert triangles - 2 * step <= now.triangles <= triangles
        assert now.triangles == record.triangles_after(collapses)
        triangles = now.triangles


@pytest.mark.parametrize("name", MESHES)
def test_any_count_can_be_had(name: str) -> None:
    mesh = MESHES[name]()
    result, record = recorded(mesh, triangles=100)
    before = len(mesh.triangles)
    for wanted in (before + 5, before, before - 1, before // 2, 301, 300, len(result.mesh.triangles)):
        replayed = record.replay(triangles=wanted)
        count = len(replayed.mesh.triangles)
        assert wanted - 1 <= count <= wanted or count == before < wanted
        if replayed.collapses:
            # One collapse fewer is not enough.
            assert record.triangles_after(replayed.collapses - 1) > wanted
    np.testing.assert_array_equal(
        record.replay(ratio=0.5).mesh.vertices, record.replay(triangles=before // 2).mesh.vertices
    )


def one_after_the_other(record: CollapseRecord, collapses: int) -> set[tuple[tuple[float, ...], ...]]:
    """Replay as the collapses took place: the triangles as the places of their corners."""
    place = dict(enumerate(map(tuple, record.mesh.vertices.tolist())))
    triangles = [tuple(t) for t in record.mesh.triangles.tolist()]
    for removed, survivor, to in list(zip(record.removed, record.survivor, record.path, strict=True))[
        :collapses
    ]:
        triangles = [tuple(survivor if v == removed else v for v in t) for t in triangles]
        triangles = [t for t in triangles if len(set(t)) == 3]
        place[int(survivor)] = tuple(to[:3].tolist())
    return {tuple(place[int(v)] for v in t) for t in triangles}


@pytest.mark.parametrize("collapses", [1, 50, 333])
def test_all_at_once_is_one_after_the_other(collapses: int) -> None:
    _, record = recorded(half_ring(), triangles=30)
    replayed = record.replay(collapses=collapses).mesh
    at_once = {tuple(map(tuple, t)) for t in replayed.vertices[replayed.triangles].tolist()}
    assert at_once == one_after_the_other(record, collapses)


def test_sources_lead_back() -> None:
    mesh = ring()
    _, record = recorded(mesh, ratio=0.1)
    replayed = record.replay(ratio=0.5)
    apart = np.linalg.norm(replayed.mesh.vertices - mesh.vertices[replayed.vertex_source], axis=1)
    assert apart.max() < 0.2
    then = mesh.vertices[mesh.triangles[replayed.triangle_source]].mean(axis=1)
    now = replayed.mesh.vertices[replayed.mesh.triangles].mean(axis=1)
    assert np.linalg.norm(now - then, axis=1).max() < 0.4


def test_a_fitted_replay_is_closer() -> None:
    mesh = ring()
    _, record = recorded(mesh, triangles=50)
    plain, fitted = (record.replay(triangles=300, fit=fit).mesh for fit in (False, True))
    np.testing.assert_array_equal(plain.triangles, fitted.triangles)
    rms = [compare(mesh, light, samples=20_000).symmetric.rms for light in (plain, fitted)]
    assert rms[1] < rms[0]


def test_locks_hold_all_the_way() -> None:
    mesh = ring()
    lock = np.arange(0, len(mesh.vertices), 9)
    _, record = recorded(mesh, ratio=0.4, lock=lock)
    assert mesh.colors is not None
    for ratio in (0.8, 0.4):
        replayed = record.replay(ratio=ratio, fit=True)
        at = np.searchsorted(replayed.vertex_source, lock)
        assert replayed.mesh.colors is not None
        np.testing.assert_array_equal(replayed.vertex_source[at], lock)
        np.testing.assert_array_equal(replayed.mesh.vertices[at], mesh.vertices[lock])
        np.testing.assert_array_equal(replayed.mesh.colors[at], mesh.colors[lock])


def test_what_is_taken_back_is_not_in_the_record(shared_data: Path) -> None:
    mesh = clean(read_mesh(shared_data / "meshes" / "redkitchen_fused_vertexcolor.ply")).mesh
    result, record = recorded(mesh, max_shape=0.005, max_texture=20)
    assert result.iterations is not None
    assert result.iterations > 3
    assert len(record.removed) == result.collapses
    assert_equal(record.replay(), result)
    was = topology(mesh)
    for ratio in (0.6, 0.3, 0.15):
        now = topology(record.replay(ratio=ratio).mesh)
        assert now.is_manifold
        assert (now.euler, now.boundary_loops) == (was.euler, was.boundary_loops)


def test_a_scan_in_patches(shared_data: Path) -> None:
    mesh = clean(read_mesh(shared_data / "meshes" / "redkitchen_fused_vertexcolor.ply")).mesh
    result, record = recorded(mesh, ratio=0.05)
    assert_equal(record.replay(fit=True), result)
    was = topology(mesh)
    for ratio in (0.7, 0.3, 0.1):
        now = topology(record.replay(ratio=ratio).mesh)
        assert now.is_manifold
        assert (now.euler, now.boundary_loops) == (was.euler, was.boundary_loops)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"triangles": 100, "ratio": 0.5}, "triangles and ratio are given"),
        ({"collapses": 10**6}, "collapses is 1000000, but the record holds only"),
        ({"triangles": 3}, "triangles asks for 3 triangles, but the record ends at 230"),
        ({"ratio": 0.001}, "ratio asks for 2 triangles, but the record ends at 230"),
        ({"collapses": -1}, "at least 0"),
        ({"count": 5}, "unknown parameter 'count'"),
    ],
)
def test_what_the_record_does_not_hold(changes: dict[str, Any], message: str) -> None:
    _, record = recorded(ring(), triangles=230)
    with pytest.raises(UsageError, match=message):
        record.replay(**changes)


# -- file ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("colored", [True, False])
def test_a_record_survives_its_file(tmp_path: Path, colored: bool) -> None:
    mesh = ring()
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]
    mesh = mesh.with_(colors=mesh.colors if colored else None, normals=normals)
    _, record = recorded(mesh, ratio=0.1, lock=[3, 4])
    path = tmp_path / "light.npz"
    record.save(path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["light.npz"]
    again = load_record(path)
    for replay in ({}, {"ratio": 0.4}, {"triangles": 500, "fit": True}):
        assert_equal(again.replay(**replay), record.replay(**replay))  # type: ignore[arg-type]


def test_a_file_cut_short_anywhere_is_bad_input(tmp_path: Path) -> None:
    _, record = recorded(ring(), ratio=0.1)
    path = tmp_path / "light.npz"
    record.save(path)
    whole = path.read_bytes()
    for length in (0, 1, 30, 1000, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"light\.npz: is damaged, or no record"):
            load_record(path)


def test_a_changed_byte_is_bad_input(tmp_path: Path) -> None:
    _, record = recorded(ring(), ratio=0.1)
    path = tmp_path / "light.npz"
    record.save(path)
    whole = path.read_bytes()
    for array in (record.mesh.vertices, record.mesh.triangles, record.removed, record.survivor, record.path):
        place = whole.index(array.tobytes()) + array.nbytes // 2
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(InputError, match=r"light\.npz: is damaged, or no record"):
            load_record(path)


def test_an_archive_nobody_wrote_like_this_is_bad_input(tmp_path: Path) -> None:
    _, record = recorded(ring(), ratio=0.1)
    path = tmp_path / "light.npz"
    record.save(path)
    content = bytearray(path.read_bytes())
    entry = content.index(b"PK\x01\x02")  # in the archive's directory; its compression is two bytes at 10
    content[entry + 10] = 99
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"light\.npz: is damaged, or no record"):
        load_record(path)


def changed(record: CollapseRecord, name: str) -> dict[str, Any]:
    """Arrays of a file with one thing wrong."""
    mesh = record.mesh
    arrays: dict[str, Any] = {
        "scanloom_collapse_record": np.array(1),
        "vertices": mesh.vertices,
        "triangles": mesh.triangles,
        "colors": mesh.colors,
        "removed": record.removed.copy(),
        "survivor": record.survivor.copy(),
        "path": record.path.copy(),
        "lock": record.lock,
    }
    match name:
        case "version":
            arrays["scanloom_collapse_record"] = np.array(2)
        case "other":
            del arrays["scanloom_collapse_record"]
        case "missing":
            del arrays["path"]
        case "type":
            arrays["removed"] = arrays["removed"].astype(np.float64)
        case "scalar":
            arrays["removed"] = np.array(3, np.int32)
        case "length":
            arrays["survivor"] = arrays["survivor"][:-1]
        case "columns":
            arrays["path"] = arrays["path"][:, :3]
        case "range":
            arrays["survivor"][5] = len(mesh.vertices)
        case "finite":
            arrays["path"][5, 1] = np.nan
        case "twice":
            arrays["removed"][9] = arrays["removed"][2]
        case "itself":
            arrays["survivor"][0] = arrays["removed"][0]
        case "gone":
            arrays["survivor"][9] = arrays["removed"][2]
        case "mesh":
            arrays["triangles"] = mesh.triangles + 1
        case "object":
            arrays["lock"] = np.array([None, 1], object)
    return arrays


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("version", "is a record of version 2; this scanloom reads version 1"),
        ("other", "is no record of collapses"),
        ("missing", "it has no path"),
        ("type", "removed is float64 of shape"),
        ("scalar", r"removed is int32 of shape \(\)"),
        ("length", "survivor is int32 of shape"),
        ("columns", "path is float64 of shape"),
        ("range", "survivor names a vertex that is not there"),
        ("finite", "a vertex goes to a place that is not finite"),
        ("twice", "collapse 2 has a vertex that is gone already"),
        ("itself", "collapse 0 has a vertex that is gone already"),
        ("gone", "collapse 9 has a vertex that is gone already"),
        ("mesh", "triangle .* uses vertices"),
        ("object", "is damaged, or no record"),
    ],
)
def test_a_record_that_cannot_be_is_named(tmp_path: Path, name: str, message: str) -> None:
    _, record = recorded(ring(), ratio=0.5)
    path = tmp_path / "light.npz"
    np.savez(path, **changed(record, name))
    with pytest.raises(InputError, match=rf"light\.npz: .*{message}"):
        load_record(path)


def test_the_unchanged_arrays_are_a_record(tmp_path: Path) -> None:
    _, record = recorded(ring(), ratio=0.5)
    np.savez(tmp_path / "light.npz", **changed(record, "nothing"))
    assert_equal(load_record(tmp_path / "light.npz").replay(), record.replay())


def test_other_files_are_no_records(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing\.npz: cannot be read: No such file"):
        load_record(tmp_path / "missing.npz")
    for name, content in (("a.npz", b"ply\nformat"), ("b.npz", b"\x93NUMPY\x01")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match="is damaged, or no record"):
            load_record(tmp_path / name)
    np.save(tmp_path / "c.npy", np.arange(3))
    with pytest.raises(InputError, match="no record of collapses"):
        load_record(tmp_path / "c.npy")


def test_no_such_folder(tmp_path: Path) -> None:
    _, record = recorded(ring(), ratio=0.5)
    with pytest.raises(StageError, match="cannot be written"):
        record.save(tmp_path / "nowhere" / "light.npz")
