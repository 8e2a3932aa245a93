from dataclasses import replace

import cv2
import numpy as np
import pytest

from scanloom.pipeline.evaluation.measurements import measure_and_draw as make
from scanloom.pipeline.evaluation.params import ReportParams
from scanloom.pipeline.evaluation.stored_deviations import read_deviations
from scanloom.stages.comparing.compare import CompareParams, compare
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.surface.mesh import Mesh

SQUARE = Mesh(
    np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32)
)
# The square and a small component a metre above it, which cleaning removes.
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


def test_removed_components_do_not_count_as_simplification_error(tmp_path):
    mesh = make(tmp_path, MESHES, [], CompareParams(samples=1000), SMALL)["mesh"]
    assert mesh["to_fused"]["distance"]["b_to_a"]["maximum_m"] == pytest.approx(0.01)
    assert mesh["to_fused"]["distance"]["a_to_b"]["maximum_m"] == pytest.approx(0.99)
    assert mesh["to_refined"]["distance"]["symmetric"]["maximum_m"] == pytest.approx(0.01)
    alone = compare(WITH_ISLAND, MESHES["simplified"], samples=250).to_dict()
    assert mesh["to_fused"] == alone, "the report measures as compare does, with a quarter of the samples"


def test_signed_deviations_are_measured_once_for_the_page(tmp_path):
    made = make(tmp_path, MESHES, [], CompareParams(samples=1000), replace(SMALL, pictures=False))
    told = made["deviation"]
    assert told["is_signed"]
    assert told["lowest_m"] == pytest.approx(0.01)
    assert told["highest_m"] == pytest.approx(0.01), "above, where the clean mesh looks to"
    kept = read_deviations(tmp_path)
    np.testing.assert_allclose(kept.at_vertices, 0.01)
    np.testing.assert_allclose(kept.vertices, MESHES["simplified"].vertices)
    assert made["pictures"] == []


def test_pictures_do_not_depend_on_other_pictures(tmp_path):
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


def _count_orange(path):
    """Count orange pixels below the caption."""
    red, green, blue = (
        cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)[30:].astype(int).transpose(2, 0, 1)
    )
    return np.count_nonzero((red > green + 60) & (green > blue + 30))


def test_filled_holes_are_drawn_from_their_visible_side(tmp_path):
    """The upper of two sheets that face each other has a filled hole, visible only from below."""
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    first = (np.arange(8)[:, None] * 9 + np.arange(8)).reshape(-1)
    corners = np.stack([first, first + 9, first + 10, first + 1], axis=1)
    up = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    vertices = np.concatenate([np.insert(grid, 2, height, axis=1) for height in (0.0, 1.0)])
    mesh = Mesh(vertices, np.concatenate([up, up[:, ::-1] + 81]).astype(np.int32))
    is_filled = (np.abs(mesh.vertices) < 0.3).all(axis=1) | (mesh.vertices == (0, 0, 1)).all(axis=1)
    is_filled[:81] = False
    frames = []
    for name, height, angle in (("from below", 0.1, 0), ("from above", 0.9, 160)):
        pose, (cosine, sine) = np.eye(4), (np.cos(np.radians(angle)), np.sin(np.radians(angle)))
        pose[1:3, 1:3] = [[cosine, -sine], [sine, cosine]]
        pose[2, 3] = height
        frames.append(Frame(name, Camera(64, 48, 30, 30, 31.5, 23.5), world_from_camera=pose))
    params, compared = ReportParams(viewpoints=3, width=320), CompareParams(samples=100)
    meshes = {"fused": mesh, "refined": mesh, "simplified": mesh}
    folders = [tmp_path / name for name in ("filled", "whole")]
    masks = (is_filled, np.zeros(len(mesh.vertices), bool))
    for folder, mask in zip(folders, masks, strict=True):
        folder.mkdir()
        made = make(folder, meshes, frames, compared, params, is_filled=mask)
        assert ("refined-filled.png" in made["pictures"]) == mask.any()
        assert (folder / "refined-filled.png").exists() == mask.any()
    assert _count_orange(folders[0] / "refined-filled.png") > 100
    assert not any(_count_orange(path) for path in folders[1].glob("*.png"))


def test_a_mesh_without_triangles_is_refused_by_name(tmp_path):
    empty = SQUARE.with_(triangles=np.zeros((0, 3), np.int32))
    with pytest.raises(InputError, match=r"refined\.ply: it has no triangles"):
        make(tmp_path, MESHES | {"refined": empty}, [], CompareParams(), SMALL)
