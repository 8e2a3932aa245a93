"""The PLY property `intensity`: read as grey colours, and written in the unit of the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanloom import Mesh, read_mesh, simplify, write_mesh
from scanloom.stages.surface.formats.ply import read_ply, read_vertex_values

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)


def write_text(
    path: Path, kind: str, values: list[Any], *, colors: bool = False, triangles: bool = True
) -> Path:
    """Write a tetrahedron as a text file with intensities of the PLY type `kind`."""
    colour = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue")) if colors else ""
    faces = f"element face {len(TRIANGLES)}\nproperty list uchar int vertex_indices\n" if triangles else ""
    rows = [
        " ".join(map(str, [*point, *((9, 8, 7) if colors else ()), value]))
        for point, value in zip(POINTS.tolist(), values, strict=True)
    ]
    if triangles:
        rows += [" ".join(map(str, [3, *triangle])) for triangle in TRIANGLES.tolist()]
    path.write_text(
        f"ply\nformat ascii 1.0\nelement vertex {len(POINTS)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"{colour}property {kind} intensity\n{faces}end_header\n" + "\n".join(rows) + "\n"
    )
    return path


@pytest.mark.parametrize(
    ("kind", "values", "levels", "full_scale"),
    [
        ("uchar", [0, 7, 200, 255], [0, 7, 200, 255], 255),
        ("uchar", [0, 0, 1, 1], [0, 0, 1, 1], 255),
        ("ushort", [0, 257, 25700, 65535], [0, 1, 100, 255], 65535),
        ("int", [0, 1, 100, 200], [0, 1, 100, 200], 255),
        ("float", [0, 0.2, 0.8, 1.0], [0, 51, 204, 255], 1),
        ("float", [0, 51.0, 204.0, 250.0], [0, 51, 204, 250], 255),
        ("double", [0, 257.0, 514.0, 60000.0], [0, 1, 2, 233], 65535),
        ("double", [0, 1e5, 5e4, 5.1e5], [0, 50, 25, 255], 5.1e5),
    ],
)
def test_intensities_survive_a_round_trip(
    tmp_path: Path, kind: str, values: list[float], levels: list[int], full_scale: float
) -> None:
    mesh = read_mesh(write_text(tmp_path / "given.ply", kind, values))
    assert mesh.diagnostics == ()
    assert mesh.colors is not None
    np.testing.assert_array_equal(mesh.colors, np.repeat(np.array(levels)[:, None], 3, axis=1))
    assert mesh.intensity_max == full_scale

    write_mesh(tmp_path / "again.ply", mesh)
    stored = read_vertex_values(tmp_path / "again.ply", "intensity")
    assert stored is not None
    np.testing.assert_allclose(stored, values, atol=full_scale / 255 / 2 * (1 + 1e-6))
    assert read_vertex_values(tmp_path / "again.ply", "red") is None

    again = read_mesh(tmp_path / "again.ply")
    np.testing.assert_array_equal(again.colors, mesh.colors)


def test_colors_have_priority_over_intensity(tmp_path: Path) -> None:
    mesh = read_mesh(write_text(tmp_path / "given.ply", "uchar", [1, 2, 3, 4], colors=True))
    assert mesh.colors is not None
    assert mesh.colors.tolist() == [[9, 8, 7]] * 4
    assert mesh.intensity_max is None
    assert ["intensity" in str(one) for one in mesh.diagnostics] == [True]


def test_a_point_cloud_gets_no_color_from_its_intensity(tmp_path: Path) -> None:
    cloud = read_ply(write_text(tmp_path / "given.ply", "uchar", [1, 2, 3, 4], triangles=False))
    assert cloud.colors is None
    assert ["intensity" in str(one) for one in cloud.diagnostics] == [True]


def test_invalid_values_become_zero_with_a_warning(tmp_path: Path) -> None:
    mesh = read_mesh(write_text(tmp_path / "given.ply", "float", [-3, "nan", 0.4, 1.0]))
    assert mesh.colors is not None
    assert mesh.colors[:, 0].tolist() == [0, 0, 102, 255]
    assert ["intensities" in str(one) for one in mesh.diagnostics] == [True]


def test_new_colors_replace_the_intensity(tmp_path: Path) -> None:
    mesh = read_mesh(write_text(tmp_path / "given.ply", "uchar", [1, 2, 3, 4]))
    painted = mesh.with_(colors=np.array([[1, 2, 3]] * 4, np.uint8))
    write_mesh(tmp_path / "painted.ply", painted)
    again = read_mesh(tmp_path / "painted.ply")
    assert again.colors is not None
    assert again.colors.tolist() == [[1, 2, 3]] * 4


@pytest.mark.parametrize("how", [{"method": "jia01"}, {"ratio": 0.2}, {"max_shape": 0.01}])
def test_a_simplified_mesh_keeps_the_intensity(tmp_path: Path, how: dict[str, Any]) -> None:
    side = np.linspace(0, 1, 21)
    x, y = np.meshgrid(side, side)
    vertices = np.stack([x, y, 0 * x], axis=2).reshape(-1, 3)
    corner = (np.arange(20)[:, None] * 21 + np.arange(20)).ravel()
    triangles = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + 22], axis=1),
            np.stack([corner, corner + 22, corner + 21], axis=1),
        ]
    )
    levels = np.rint(255 * vertices[:, :1]).astype(np.uint8)
    grey = Mesh(vertices, triangles.astype(np.int32), colors=np.repeat(levels, 3, axis=1), intensity_max=1.0)
    write_mesh(tmp_path / "grey.ply", grey)

    result = simplify(read_mesh(tmp_path / "grey.ply"), **how)
    write_mesh(tmp_path / "simplified.ply", result.mesh)

    assert len(result.mesh.triangles) < len(triangles)
    stored = read_vertex_values(tmp_path / "simplified.ply", "intensity")
    assert stored is not None
    np.testing.assert_allclose(stored, result.mesh.vertices[:, 0], atol=0.06)


def test_one_intensity_counts_as_one_channel() -> None:
    """A step of 60 levels is a contrast of 60 for intensity, and of 104 for three equal channels."""
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]], float)
    strip = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]], np.int32)
    shades = np.repeat(np.array([100, 100, 160] * 2, np.uint8)[:, None], 3, axis=1)
    grey = Mesh(points, strip, colors=shades, intensity_max=255.0)
    bounds: dict[str, Any] = {"method": "jia01", "max_shape": 1.0, "max_color": 130.0}
    settings: dict[str, Any] = {"jia01": {"resolution": 10.0}}
    one = simplify(grey, **bounds, **settings)
    three = simplify(grey.with_(intensity_max=None), **bounds, **settings)
    assert one.collapses > three.collapses
