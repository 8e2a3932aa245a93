from dataclasses import replace

import numpy as np
import pytest

from scanloom.pipeline.evaluation.measurements import measure_and_draw as make
from scanloom.pipeline.evaluation.params import ReportParams
from scanloom.pipeline.evaluation.stored_deviations import read_deviations
from scanloom.stages.comparing.compare import CompareParams, compare
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.surface.mesh import Mesh

SQUARE = Mesh(
    np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32)
)
# The square and an island a metre above it, which cleaning removes.
WITH_ISLAND = Mesh(
    np.vstack([SQUARE.vertices, SQUARE.vertices[:3] * 0.1 + (0, 0, 1)]),
    np.vstack([SQUARE.triangles, [[4, 5, 6]]]).astype(np.int32),
)
MESHES = {
    "fused": WITH_ISLAND,
    "refined": SQUARE,
    "simplified": SQUARE.with_(vertices=SQUARE.vertices + np.array((0, 0, 0.01))),
}
SMALL = ReportParams(viewpoints=1, width=64)


def test_islands_that_were_removed_do_not_count_as_an_error_of_simplification(tmp_path):
    mesh = make(tmp_path, MESHES, [], CompareParams(samples=1000), SMALL)["mesh"]
    assert mesh["to_fused"]["distance"]["b_to_a"]["maximum_m"] == pytest.approx(0.01)
    assert mesh["to_fused"]["distance"]["a_to_b"]["maximum_m"] == pytest.approx(0.99)
    assert mesh["to_refined"]["distance"]["symmetric"]["maximum_m"] == pytest.approx(0.01)
    alone = compare(WITH_ISLAND, MESHES["simplified"], samples=1000).to_dict()
    assert mesh["to_fused"] == alone, "the report measures as compare does"


def test_the_result_is_measured_with_signs_once_for_its_page(tmp_path):
    made = make(tmp_path, MESHES, [], CompareParams(samples=1000), replace(SMALL, pictures=False))
    told = made["deviation"]
    assert told["is_signed"]
    assert told["lowest_m"] == pytest.approx(0.01)
    assert told["highest_m"] == pytest.approx(0.01), "above, where the clean mesh looks to"
    kept = read_deviations(tmp_path)
    np.testing.assert_allclose(kept.at_vertices, 0.01)
    np.testing.assert_allclose(kept.vertices, MESHES["simplified"].vertices)
    assert made["pictures"] == []


def test_pictures_are_the_same_whatever_is_drawn_beside_them(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    small = CompareParams(samples=100)
    made = make(tmp_path / "a", MESHES, [], small, SMALL)
    again = make(tmp_path / "b", MESHES, [], small, SMALL)
    assert made == again
    names = [f"{mesh}-view1.png" for mesh in MESHES]
    assert made["pictures"] == [*names, "simplified-triangles.png"]
    for name in made["pictures"]:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_a_mesh_without_triangles_is_refused_by_name(tmp_path):
    empty = SQUARE.with_(triangles=np.zeros((0, 3), np.int32))
    with pytest.raises(InputError, match=r"refined\.ply: it has no triangles"):
        make(tmp_path, MESHES | {"refined": empty}, [], CompareParams(), SMALL)
