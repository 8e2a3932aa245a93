"""Vertex clustering of files: all vertices of a cell are merged, and the file is read in batches."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.surface import vertex_clustering
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.vertex_clustering import read_clustered_mesh


def random_mesh(seed: int, vertices: int, triangles: int, *, colored: bool) -> Mesh:
    rng = np.random.default_rng(seed)
    return Mesh(
        rng.normal(size=(vertices, 3)) * [3, 1, 0.1] + [500_000, 0, -7],
        rng.integers(0, vertices, (triangles, 3)).astype(np.int32),
        rng.integers(0, 256, (vertices, 3)).astype(np.uint8) if colored else None,
    )


def cluster_by_cell(mesh: Mesh, cell: float) -> tuple[list[list[float]], set[tuple[int, ...]]]:
    """Compute mean positions and colours of the used cells and the remaining triangles, cell by cell."""
    low, inside = mesh.vertices.min(axis=0), defaultdict(list)
    longest = np.ptp(mesh.vertices, axis=0).max()
    cells = [tuple(min(int(x), round(longest / cell) - 1) for x in (p - low) / cell) for p in mesh.vertices]
    for number, at in enumerate(cells):
        inside[at].append(number)
    left = [t for t in mesh.triangles.tolist() if len({cells[v] for v in t}) == 3]
    used = sorted({cells[v] for t in left for v in t})
    colors = np.zeros((len(mesh.vertices), 0)) if mesh.colors is None else mesh.colors
    values = np.hstack([mesh.vertices, colors])
    means = [values[inside[at]].mean(axis=0).tolist() for at in used]
    turned = set()
    for a, b, c in ([used.index(cells[v]) for v in t] for t in left):
        turned.add(min((a, b, c), (b, c, a), (c, a, b)))
    return means, turned


@given(
    st.integers(0, 2**32 - 1), st.integers(3, 300), st.integers(0, 200), st.integers(8, 200), st.booleans()
)
@settings(max_examples=40, deadline=None)
def test_clustering_agrees_with_the_definition(
    tmp_path_factory: pytest.TempPathFactory,
    seed: int,
    vertices: int,
    triangles: int,
    most: int,
    colored: bool,
) -> None:
    path = tmp_path_factory.mktemp("clusters") / "mesh.ply"
    mesh = random_mesh(seed, vertices, triangles, colored=colored)
    write_ply(path, mesh)
    found = read_clustered_mesh(path, most)
    assert len(found.mesh.vertices) <= most
    assert found.triangle_count == triangles
    means, turned = cluster_by_cell(mesh, found.cell_size)
    assert len(found.mesh.vertices) == len(means)
    if means:
        made = np.array(means)
        np.testing.assert_allclose(found.mesh.vertices, made[:, :3], rtol=1e-12)
        if colored:
            assert found.mesh.colors is not None
            np.testing.assert_allclose(found.mesh.colors, made[:, 3:], atol=0.5 + 1e-9)
    assert found.mesh.colors is None or colored
    assert {tuple(t) for t in found.mesh.triangles.tolist()} == turned
    assert len(found.mesh.triangles) == len(turned)


def test_results_do_not_depend_on_the_batch_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_ply(tmp_path / "mesh.ply", random_mesh(1, 500, 900, colored=True))
    at_once = read_clustered_mesh(tmp_path / "mesh.ply", 60)
    monkeypatch.setattr(vertex_clustering, "_ROWS_PER_CHUNK", 7)
    by_rows = read_clustered_mesh(tmp_path / "mesh.ply", 60)
    np.testing.assert_allclose(by_rows.mesh.vertices, at_once.mesh.vertices, rtol=1e-12)
    np.testing.assert_array_equal(by_rows.mesh.triangles, at_once.mesh.triangles)


def test_a_mesh_coarser_than_the_cells_is_unchanged(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0), indexing="ij")
    first = np.arange(380)[np.arange(380) % 20 < 19]
    halves = [np.stack([first, first + 20, first + 1]), np.stack([first + 20, first + 21, first + 1])]
    mesh = Mesh(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), np.hstack(halves).T.astype(np.int32))
    write_ply(tmp_path / "grid.ply", mesh)
    found = read_clustered_mesh(tmp_path / "grid.ply", 1000).mesh
    np.testing.assert_allclose(found.vertices, mesh.vertices)
    assert {tuple(t) for t in found.triangles.tolist()} == {
        min((a, b, c), (b, c, a), (c, a, b)) for a, b, c in mesh.triangles.tolist()
    }


def _truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5])


def _write_invalid_index(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-4] + np.int32(3_000).tobytes())


def _write_nan(path: Path) -> None:
    data = path.read_bytes()
    start = data.index(b"end_header\n") + len(b"end_header\n")
    path.write_bytes(data[:start] + np.float64(np.nan).tobytes() + data[start + 8 :])


def _write_quad(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-13] = 4
    path.write_bytes(data)


def _write_ascii(path: Path) -> None:
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (_truncate, "not as long as its header promises"),
        (_write_invalid_index, "references a vertex that does not exist"),
        (_write_nan, "a vertex is not finite"),
        (_write_quad, "faces that are not triangles"),
        (_write_ascii, "not a binary file of vertices and triangles alone"),
        (Path.unlink, "cannot be read"),
        (lambda path: path.write_bytes(b"solid"), "is not a PLY file"),
    ],
)
def test_damaged_files_are_reported(damage: object, words: str, tmp_path: Path) -> None:
    path = tmp_path / "mesh.ply"
    write_ply(path, random_mesh(2, 30, 40, colored=True))
    damage(path)  # type: ignore[operator]
    with pytest.raises(InputError, match=words):
        read_clustered_mesh(path, 100)


@pytest.mark.parametrize("vertices", [0, 4])
def test_a_file_without_a_triangle_is_an_empty_mesh(vertices: int, tmp_path: Path) -> None:
    write_ply(tmp_path / "mesh.ply", Mesh(np.zeros((vertices, 3)), np.zeros((0, 3), np.int32)))
    assert len(read_clustered_mesh(tmp_path / "mesh.ply", 100).mesh.triangles) == 0
