"""The curve of error against triangles is that of simplify and compare, and its suggestion what it says."""

from __future__ import annotations

import json

import numpy as np
import pytest
from coloured_meshes import ball, sheet
from seamed_meshes import wrapped_ball

from scanloom import Mesh, MeshError, Tradeoff, UsageError, compare, simplify, tradeoff


@pytest.fixture(scope="module")
def found() -> Tradeoff:
    return tradeoff(sheet(40), steps=7, min_ratio=0.03, samples=20_000)


def test_points_go_from_all_to_few_and_errors_grow(found: Tradeoff) -> None:
    counts = [point.triangles for point in found.points]
    assert counts[0] == 3200
    np.testing.assert_allclose(np.diff(np.log(counts)), np.log(0.03) / 6, atol=0.03)
    assert found.method == "quadric"
    for name in ("rms_m", "percentile_95_m", "color_rmse_levels"):
        values = [getattr(point, name) for point in found.points]
        assert values == sorted(values), name
        assert values[0] < 1e-9 < values[1]
    assert all(point.rms_m <= point.percentile_95_m <= point.maximum_m for point in found.points[1:])
    assert [point.ratio for point in found.points] == [count / 3200 for count in counts]


def test_errors_are_those_of_simplify_as_compare_measures_them(found: Tradeoff) -> None:
    mesh = sheet(40)
    for point in found.points[2:]:
        light = simplify(mesh, triangles=point.triangles).mesh
        told = compare(mesh, light, samples=20_000)
        assert point.rms_m == pytest.approx(told.symmetric.rms, rel=0.15)
        # How much colours weigh is derived from the number, and there is one weight on this way.
        assert 0.5 < point.color_rmse_levels / told.color.rmse < 2
    # The last is the very mesh, so that only the points differ that are drawn.
    assert point.rms_m == pytest.approx(told.symmetric.rms, rel=0.03)
    assert point.color_rmse_levels == pytest.approx(told.color.rmse, rel=0.03)
    assert point.maximum_m == pytest.approx(told.symmetric.maximum, rel=0.2)


def test_the_record_leads_to_the_mesh_of_every_point(found: Tradeoff) -> None:
    for point in found.points:
        assert len(found.record.replay(triangles=point.triangles).mesh.triangles) == point.triangles
    assert len(found.mesh.triangles) == found.suggested_triangles


def test_the_bend_is_suggested() -> None:
    # A ball: the error goes with one over the number, and bends most at 1 / 4.6 of the way in logarithms.
    found = tradeoff(ball().with_(colors=None), steps=9, min_ratio=0.01, samples=2000)
    assert found.suggested_triangles is not None
    assert 0.02 < found.suggested_triangles / len(ball().triangles) < 0.1
    assert found.points[0].color_rmse_levels is None


def test_the_smallest_number_within_a_distance_is_suggested(found: Tradeoff) -> None:
    within = found.points[3].percentile_95_m
    counts = [point.triangles for point in found.points]
    again = tradeoff(sheet(40), counts=counts, samples=20_000, max_distance=within)
    assert again.points == found.points
    assert again.suggested_triangles == found.points[3].triangles
    none = tradeoff(sheet(40), counts=[100], samples=1000, max_distance=1e-9)
    assert none.suggested_triangles is None
    assert len(none.mesh.triangles) == 100


def test_counts_are_put_in_order_and_cut_to_what_there_is() -> None:
    found = tradeoff(sheet(10), counts=[50, 10**9, 120, 50], samples=1000)
    # A collapse takes two triangles, or one at the border.
    assert [found.points[k].triangles in (n, n - 1) for k, n in enumerate((200, 120, 50))] == [True] * 3
    with pytest.raises(UsageError, match="counts contains 0; a triangle count must be at least 1"):
        tradeoff(sheet(10), counts=[0])


def test_where_nothing_may_collapse_any_more_the_curve_ends_and_says_so() -> None:
    tetrahedron = Mesh(
        np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float),
        np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], np.int32),
    )
    found = tradeoff(tetrahedron, samples=100)
    assert [point.triangles for point in found.points] == [4]
    assert found.suggested_triangles is None
    assert [str(one) for one in found.diagnostics] == [
        "no edge can collapse below 4 triangles, which holes, handles and components need"
    ]


def test_textured_meshes_keep_their_texture_and_say_what_is_not_in_the_metrics() -> None:
    found = tradeoff(wrapped_ball(), steps=4, min_ratio=0.1, samples=5000, glb_bytes=True)
    assert found.method == "seams"
    assert found.mesh.texture is not None
    assert "before the final fit" in str(found.diagnostics[-1])
    assert all(point.color_rmse_levels is not None for point in found.points)
    sizes = [point.glb_bytes for point in found.points]
    assert sizes == sorted(sizes, reverse=True)


def test_it_prints_as_a_table(found: Tradeoff) -> None:
    told = json.loads(json.dumps(found.to_dict()))
    assert [point["triangles"] for point in told["points"]] == [point.triangles for point in found.points]
    head, first, *_ = found.to_rows()
    assert head == ["triangles", "ratio", "RMS m", "95 % m", "maximum m", "colour levels"]
    assert first[:2] == ["3,200", "100 %"]
    html = found._repr_html_()
    assert html.count("<tr>") > 8
    assert "suggested triangles" in html


def test_progress_is_told_and_may_stop_the_work() -> None:
    told: list[tuple[int, int]] = []
    tradeoff(sheet(10), counts=[100, 50], samples=100, progress=lambda *far: told.append(far))
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize(
    "wrong", [{"steps": 1}, {"min_ratio": 0.0}, {"min_ratio": 2.0}, {"max_distance": -1.0}]
)
def test_wrong_parameters(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError, match=next(iter(wrong))):
        tradeoff(sheet(4), **wrong)


def test_a_mesh_without_area_is_refused() -> None:
    with pytest.raises(MeshError):
        tradeoff(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)))
