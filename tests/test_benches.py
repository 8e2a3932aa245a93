"""What the benches build and conclude; what they measure is no matter of tests."""

import dataclasses
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from stages.mesh import Mesh
from stages.topology import topology

ROOT = Path(__file__).resolve().parents[1]
MAP = np.arange(8 * 16 * 3, dtype=np.uint8).reshape(8, 16, 3) % 200


@pytest.fixture(autouse=True)
def _benches(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(ROOT / "benches"))


@pytest.fixture
def meshes() -> ModuleType:
    import meshes

    return meshes


@pytest.fixture
def bench() -> ModuleType:
    import simplify

    return simplify


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_the_globe_is_a_closed_unit_sphere_facing_outward(meshes: ModuleType, steps: int):
    globe = meshes.globe(steps, MAP)

    assert len(globe.triangles) == 8 * steps**2
    shape = topology(globe)
    assert shape.is_closed
    assert shape.is_manifold
    assert shape.is_oriented
    assert shape.euler == 2
    np.testing.assert_allclose(np.linalg.norm(globe.vertices, axis=1), 1)
    a, b, c = globe.vertices[globe.triangles].swapaxes(0, 1)
    assert (np.cross(b - a, c - a) * a).sum(axis=1).min() > 0


def test_the_globe_s_map_closes_at_the_date_line_and_ends_at_the_poles(meshes: ModuleType):
    globe = meshes.globe(2, MAP)

    def at(*direction: float) -> Any:
        return globe.colors[(globe.vertices @ direction).argmax()].astype(float)

    middle = slice(3, 5)  # the equator runs between rows 3 and 4
    np.testing.assert_allclose(at(1, 0, 0), MAP[middle, 7:9].mean(axis=(0, 1)), atol=0.51)
    np.testing.assert_allclose(at(-1, 0, 0), MAP[middle][:, [0, -1]].mean(axis=(0, 1)), atol=0.51)
    np.testing.assert_allclose(at(0, 1, 0), MAP[middle, 11:13].mean(axis=(0, 1)), atol=0.51)
    np.testing.assert_allclose(at(0, 0, 1), MAP[0, 7:9].mean(axis=0), atol=0.51)
    np.testing.assert_allclose(at(0, 0, -1), MAP[-1, 7:9].mean(axis=0), atol=0.51)


def test_flat_colours_are_sea_land_and_ice():
    import jia_table

    image = np.empty((64, 90, 3), np.uint8)
    image[:, :30], image[:, 30:60], image[:, 60:] = (10, 30, 80), (120, 110, 60), (230, 235, 240)

    flat = jia_table.flat(image)

    for column, expected in ((15, jia_table.SEA), (45, jia_table.LAND), (75, jia_table.ICE)):
        assert (flat[:, column] == expected).all()


@pytest.mark.parametrize("name", ["scanloom", "Open3D legacy", "Open3D tensor"])
def test_a_tool_s_result_is_a_mesh_of_the_wanted_size(meshes: ModuleType, name: str):
    from peers.tools import TOOLS

    globe = meshes.globe(12, MAP)
    (tool,) = [tool for tool in TOOLS if tool.name == name]

    call, unpacked = tool.prepare(globe, 400, **next(iter(tool.settings.values())))
    light = unpacked(call())

    assert 380 <= len(light.triangles) <= 400
    assert topology(light).is_closed
    assert (light.colors is not None) == tool.keeps_color


def test_turned_triangles_and_small_angles_are_counted(meshes: ModuleType, bench: ModuleType):
    globe = meshes.globe(4, MAP)
    turned = globe.triangles.copy()
    turned[[3, 50]] = turned[[3, 50], ::-1]

    assert bench.turned(globe, globe) == 0
    assert bench.turned(globe, globe.with_(triangles=turned)) == 2

    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], float)
    pair = Mesh(corners, np.array([[0, 1, 2], [0, 1, 3]], np.int32))
    np.testing.assert_allclose(bench.smallest_angles(pair), [45, 0])


def test_a_setting_beats_another_only_in_both_errors_and_on_no_more_triangles(bench: ModuleType):
    base = bench.Row(
        **{field.name: 0 for field in dataclasses.fields(bench.Row)}
        | {"mesh": "globe", "ratio": 0.1, "triangles": 1000, "rms": 1.0, "color": 5.0, "setting": "default"}
    )

    def row(**changes: Any) -> Any:
        return dataclasses.replace(base, **changes)

    assert bench.is_better(row(rms=0.9, color=4.9), base)
    assert not bench.is_better(row(rms=0.9, color=5.0), base)
    assert not bench.is_better(row(rms=1.0, color=4.9), base)
    assert not bench.is_better(row(rms=0.9, color=4.9, triangles=1011), base)
    assert not bench.is_better(row(rms=0.9, color=4.9), row(color=None))

    own = [row(tool="scanloom", rms=2.0), row(tool="scanloom", setting="light", rms=0.9, color=4.0)]
    peers = [
        row(tool="VTK", setting="weight 1"),
        row(tool="VTK", setting="weight 2", color=3.0),
        row(tool="Open3D tensor", setting="", rms=0.8, color=None),
        row(tool="CGAL Lindstrom–Turk", setting="", rms=0.5, color=None),
    ]
    text = "\n".join(bench.verdicts([*own, *peers]))

    assert "VTK: 1 of 2 beaten (weight 1 ← light; weight 2 ← none)" in text
    assert "default is 2.50 times that of Open3D tensor, the best quadric tool" in text
    assert "default is 4.00 times that of CGAL Lindstrom–Turk, the best tool" in text
