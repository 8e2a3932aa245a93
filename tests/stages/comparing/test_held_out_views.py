"""Evaluation of a mesh by held-out photos, also with slightly wrong poses."""

from dataclasses import replace

import numpy as np
import pytest
from wall_photos import paint, photo, photos, pose, wall

from scanloom.stages.comparing import held_out_views as left_out_module
from scanloom.stages.comparing.held_out_views import evaluate_held_out_photos
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.texturing.texture import texture


@pytest.fixture(scope="module")
def painted() -> Mesh:
    return texture(wall(), photos(12), format="png").mesh


def test_a_good_texture_scores_better_than_a_grey_wall(painted):
    held_out = [photo(0, pose(0.5, 0.5)), photo(1, pose(0.48, 0.53, z=-0.6, turn=4))]
    good = evaluate_held_out_photos(painted, held_out).to_dict()
    assert good["photos"] == 2
    assert good["psnr_raw_db"] > 30
    assert good["ssim"] > 0.93
    assert good["sharpness"] == pytest.approx(1, abs=0.15)
    assert good["coverage_ratio"] > 0.9
    grey = evaluate_held_out_photos(wall(colors=np.full((13 * 13, 3), 128, np.uint8)), held_out).to_dict()
    assert grey["psnr_affine_db"] < 18
    assert grey["sharpness"] < 0.1


def test_a_photo_with_a_wrong_pose_is_localised(painted):
    frame = photo(0, pose(0.5, 0.5))
    off = replace(frame, world_from_camera=pose(0.53, 0.49))
    found = evaluate_held_out_photos(painted, [off])
    assert found.scores[0].is_localized
    assert found.scores[0].affine > 26
    assert found.comparison_images["worst"].shape == (120, 320, 3)


def test_a_large_photo_is_localised_at_lower_resolution_and_evaluated_at_full(painted, monkeypatch):
    off = replace(photo(0, pose(0.5, 0.5)), world_from_camera=pose(0.53, 0.49))
    (whole,) = evaluate_held_out_photos(painted, [off]).scores
    monkeypatch.setattr(left_out_module, "_MAX_LOCALIZATION_SIDE_PX", 120)
    found = evaluate_held_out_photos(painted, [off])
    (score,) = found.scores
    assert score.is_localized
    assert score.affine > whole.affine - 1
    assert score.coverage == pytest.approx(whole.coverage, abs=0.01)
    assert found.comparison_images["worst"].shape == (120, 320, 3)


def test_a_pose_with_little_overlap_is_not_used(painted, monkeypatch):
    frame = replace(photo(0, pose(0.5, 0.5)), world_from_camera=pose(0.6, 0.45))
    # From that pose the wall only fills a corner of the image, so hardly any error could be measured.
    corner_pose = pose(1.4, -0.3)

    def return_candidates(
        _image: object, _camera: object, given: np.ndarray, _surface: object
    ) -> list[np.ndarray]:
        return [given, corner_pose]

    monkeypatch.setattr(left_out_module, "generate_pose_candidates", return_candidates)
    monkeypatch.setattr(left_out_module, "_MIN_MESH_PIXELS", 1)
    (score,) = evaluate_held_out_photos(painted, [frame]).scores
    assert not score.is_localized
    monkeypatch.setattr(left_out_module, "_MIN_COVERAGE_RATIO", 0.0)
    (score,) = evaluate_held_out_photos(painted, [frame]).scores
    assert score.is_localized


def test_exposure_affects_only_the_raw_score(painted):
    frame = photo(0, pose(0.5, 0.5))
    darker = replace(frame, color=(np.asarray(frame.color) * 0.6).astype(np.uint8))
    (score,) = evaluate_held_out_photos(painted, [darker]).scores
    assert score.affine > score.raw + 8


def test_frames_that_cannot_be_evaluated_are_listed(painted):
    lost = replace(photo(0, pose(0.5, 0.5)), world_from_camera=None)
    away = photo(1, pose(40.0, 0.5))
    found = evaluate_held_out_photos(painted, [lost, away, replace(lost, color=None)])
    assert [one.diagnostic.message for one in found.skipped] == [
        "there is no camera pose.",
        "the photo does not show the mesh.",
        "there is no colour image.",
    ]
    assert found.to_dict()["psnr_raw_db"] is None
    assert paint(np.array(0.5), np.array(0.5)).shape == (3,)


@pytest.mark.slow
def test_a_rolling_shutter_photo_is_localised_with_its_rotation(painted):
    rolling = photo(0, pose(0.5, 0.5), turn=np.radians((2.25, -3.75, 1.5)))
    (as_if_at_once,) = evaluate_held_out_photos(painted, [rolling]).scores
    # The shutter of held-out frames is known to roll, but their rotation is unknown.
    (with_turn,) = evaluate_held_out_photos(
        painted, [replace(rolling, shutter_turn=np.radians((0.0, 1.0, 0.0)))]
    ).scores
    assert with_turn.affine > as_if_at_once.affine + 4
    assert with_turn.affine > 26
