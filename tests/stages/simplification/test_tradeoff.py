"""Tradeoff of error and triangle count: equal to simplify and compare, with a documented suggestion."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from coloured_meshes import ball, sheet
from seamed_meshes import wrapped_ball

from scanloom import Mesh, MeshError, SimplificationResult, Tradeoff, UsageError, compare, simplify, tradeoff
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.tradeoff import TradeoffPoint, _find_flying


@pytest.fixture(scope="module")
def found() -> Tradeoff:
    return tradeoff(sheet(40), steps=7, min_ratio=0.03, samples=20_000)


def test_errors_grow_from_all_triangles_to_few(found: Tradeoff) -> None:
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


def test_errors_equal_those_of_simplify_and_compare(found: Tradeoff) -> None:
    mesh = sheet(40)
    for point in found.points[2:]:
        light = simplify(mesh, triangles=point.triangles).mesh
        measured = compare(mesh, light, samples=20_000)
        assert point.rms_m == pytest.approx(measured.symmetric.rms, rel=0.15)
        # The weight of colours follows from the count, but a tradeoff has a single weight.
        assert 0.5 < point.color_rmse_levels / measured.color.rmse < 2
    # The last point has exactly the mesh of simplify, so only the samples differ.
    assert point.rms_m == pytest.approx(measured.symmetric.rms, rel=0.03)
    assert point.color_rmse_levels == pytest.approx(measured.color.rmse, rel=0.03)
    assert point.maximum_m == pytest.approx(measured.symmetric.maximum, rel=0.2)


def test_the_record_replays_to_the_mesh_of_every_point(found: Tradeoff) -> None:
    for point in found.points:
        assert len(found.record.replay(triangles=point.triangles).mesh.triangles) == point.triangles
    assert len(found.mesh.triangles) == found.suggested_triangles


def test_the_bend_of_the_curve_is_suggested() -> None:
    # The error of a ball is inversely proportional to the count; in logarithms, the curve bends most at 1 /
    # 4.6 of its length.
    found = tradeoff(ball().with_(colors=None), steps=9, min_ratio=0.01, samples=2000)
    assert found.suggested_triangles is not None
    assert 0.02 < found.suggested_triangles / len(ball().triangles) < 0.1
    assert found.points[0].color_rmse_levels is None


def test_the_smallest_count_within_a_distance_is_suggested(found: Tradeoff) -> None:
    within = found.points[3].percentile_95_m
    counts = [point.triangles for point in found.points]
    again = tradeoff(sheet(40), counts=counts, samples=20_000, max_distance=within)
    assert again.points == found.points
    assert again.suggested_triangles == found.points[3].triangles
    none = tradeoff(sheet(40), counts=[100], samples=1000, max_distance=1e-9)
    assert none.suggested_triangles is None
    assert len(none.mesh.triangles) == 100


def test_a_smaller_mesh_with_a_proven_distance_is_suggested() -> None:
    mesh = ball().with_(colors=None)
    found = tradeoff(mesh, steps=3, min_ratio=0.3, samples=2000, max_distance=0.01)
    light = simplify(mesh, max_shape=0.01).mesh
    assert len(light.triangles) < found.points[-1].triangles
    assert found.suggested_triangles == len(found.mesh.triangles) == len(light.triangles)
    assert found.bounded is not None
    assert found.bounded.maximum_m <= 0.01
    assert found.to_dict()["bounded"]["triangles"] == len(light.triangles)
    assert "max_shape=0.01" in found.criterion
    # For an extremely small distance, no smaller mesh exists.
    assert tradeoff(mesh, steps=2, min_ratio=0.5, samples=2000, max_distance=1e-12).bounded is None


def test_a_mesh_with_distant_vertices_is_simplified_again_or_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mesh = sheet(20)
    real = CollapseRecord.replay

    def replay_with_distant_vertex(record: CollapseRecord, **wanted: Any) -> SimplificationResult[Any]:
        result = real(record, **wanted)
        if result.mesh.vertices.shape[0] == len(mesh.vertices):
            return result
        vertices = result.mesh.vertices.copy()
        vertices[result.mesh.triangles[0, 0], 2] += 5.0
        return replace(result, mesh=result.mesh.with_(vertices=vertices))

    steps = {"steps": 5, "min_ratio": 0.1, "samples": 2000}
    whole = tradeoff(mesh, **steps)
    monkeypatch.setattr(CollapseRecord, "replay", replay_with_distant_vertex)
    anew = tradeoff(mesh, **steps)
    assert not [one for one in anew.diagnostics if "fly apart" in one.message]
    assert anew.suggested_triangles == whole.suggested_triangles
    for point, other in zip(anew.points, whole.points, strict=True):
        assert point.triangles == other.triangles
        assert point.maximum_m <= 2 * other.maximum_m + 1e-9

    def simplify_with_distant_vertex(*given: Any, **wanted: Any) -> SimplificationResult[Any]:
        result = simplify(*given, **wanted)
        vertices = result.mesh.vertices.copy()
        vertices[result.mesh.triangles[0, 0], 2] += 5.0
        return result if wanted.get("record") else replace(result, mesh=result.mesh.with_(vertices=vertices))

    monkeypatch.setattr("scanloom.stages.simplification.tradeoff.simplify", simplify_with_distant_vertex)
    flown = tradeoff(mesh, **steps, max_distance=0.1)
    (warning,) = [one for one in flown.diagnostics if "fly apart" in one.message]
    assert f"{flown.points[1].triangles:,}, {flown.points[2].triangles:,}" in warning.message
    assert flown.suggested_triangles not in [point.triangles for point in flown.points[1:]]


def test_distant_vertices_are_detected_outside_the_box_and_at_single_points() -> None:
    def make_point(triangles: int, near: float, far: float) -> TradeoffPoint:
        return TradeoffPoint(
            triangles=triangles,
            ratio=triangles / 1000,
            rms_m=near,
            percentile_95_m=near,
            maximum_m=far,
            color_rmse_levels=None,
            glb_bytes=None,
        )

    smooth = [
        make_point(1000, 0, 0),
        make_point(500, 0.001, 0.005),
        make_point(200, 0.002, 0.01),
        make_point(100, 0.004, 0.02),
    ]
    none = [0.0] * 4
    assert _find_flying(smooth, none, 1.0).tolist() == [False] * 4
    assert _find_flying(smooth, [0, 0.001, 0, 0.1], 1.0).tolist() == [False, False, False, True]
    # The maximum is far larger than the RMS, or than the maximum of smaller meshes.
    single = [*smooth[:2], make_point(200, 0.002, 0.021), smooth[3]]
    assert _find_flying(single, none, 1.0).tolist() == [False, False, True, False]
    spike = [*smooth[:2], make_point(200, 0.05, 0.1), smooth[3]]
    assert _find_flying(spike, none, 1.0).tolist() == [False, False, True, False]
    # Almost exact meshes may differ by large factors.
    assert _find_flying(single, none, 10.0).tolist() == [False] * 4


def test_counts_are_sorted_and_limited() -> None:
    found = tradeoff(sheet(10), counts=[50, 10**9, 120, 50], samples=1000)
    # A collapse removes two triangles, or one at the boundary.
    assert [found.points[k].triangles in (n, n - 1) for k, n in enumerate((200, 120, 50))] == [True] * 3
    with pytest.raises(UsageError, match="counts contains 0; a triangle count must be at least 1"):
        tradeoff(sheet(10), counts=[0])


def test_the_curve_ends_with_a_diagnostic_if_no_edge_can_collapse() -> None:
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


def test_textured_meshes_keep_their_texture_with_a_diagnostic_about_metrics() -> None:
    found = tradeoff(wrapped_ball(), steps=4, min_ratio=0.1, samples=5000, glb_bytes=True)
    assert found.method == "seams"
    assert found.mesh.texture is not None
    assert "before the final fit" in str(found.diagnostics[-1])
    assert all(point.color_rmse_levels is not None for point in found.points)
    sizes = [point.glb_bytes for point in found.points]
    assert sizes == sorted(sizes, reverse=True)


def test_a_tradeoff_is_printed_as_a_table(found: Tradeoff) -> None:
    result = json.loads(json.dumps(found.to_dict()))
    assert [point["triangles"] for point in result["points"]] == [point.triangles for point in found.points]
    head, first, *_ = found.to_rows()
    assert head == ["triangles", "ratio", "RMS m", "95 % m", "maximum m", "colour levels"]
    assert first[:2] == ["3,200", "100 %"]
    html = found._repr_html_()
    assert html.count("<tr>") > 8
    assert "suggested triangles" in html


def test_progress_is_reported() -> None:
    calls: list[tuple[int, int]] = []
    tradeoff(sheet(10), counts=[100, 50], samples=100, progress=lambda *far: calls.append(far))
    assert calls == [(0, 3), (1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize(
    "wrong", [{"steps": 1}, {"min_ratio": 0.0}, {"min_ratio": 2.0}, {"max_distance": -1.0}]
)
def test_parameters_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError, match=next(iter(wrong))):
        tradeoff(sheet(4), **wrong)


def test_a_mesh_without_area_is_refused() -> None:
    with pytest.raises(MeshError):
        tradeoff(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)))
