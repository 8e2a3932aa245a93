"""Texturing from photos: the wall shows the paint, despite occluders, passers-by and reflections."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from wall_photos import (
    CAMERA,
    change_exposure,
    intersect_plane,
    make_grazing_photo,
    paint,
    photo,
    photos,
    pose,
    wall,
)

from scanloom import InputError, MeshError, UsageError
from scanloom.stages.progress import ignore_progress
from scanloom.stages.scans.model.images import read_photo
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh
from scanloom.stages.surface.surface_color import compute_surface_colors
from scanloom.stages.texturing import photo_painting, photo_survey, provenance_maps
from scanloom.stages.texturing import photos as photos_module
from scanloom.stages.texturing.photo_sampling import sample_photos
from scanloom.stages.texturing.provenance_maps import write_maps
from scanloom.stages.texturing.texture import TextureResult, texture

INNER = (0.2, 0.8)


@cache
def texture_wall(count: int, kind: str = "jpeg") -> TextureResult:
    """Texture the wall from `count` photos; the result is cached, because several tests use it."""
    return texture(wall(), photos(count), format=kind)


def sample_colors(
    mesh: Mesh, triangles: np.ndarray | None = None, count: int = 4000
) -> tuple[np.ndarray, np.ndarray]:
    """Sample colours of the mesh at random positions; return colours and positions, (k, 3) each."""
    rng = np.random.default_rng(3)
    chosen = rng.choice(len(mesh.triangles) if triangles is None else triangles, count)
    weights = rng.dirichlet((1, 1, 1), count)
    places = np.einsum("kc,kcx->kx", weights, mesh.vertices[mesh.triangles[chosen]])
    return compute_surface_colors(mesh, chosen, weights), places


def measure_errors(mesh: Mesh) -> np.ndarray:
    """Compute the largest channel difference from the paint in levels, in the middle of the wall."""
    colors, places = sample_colors(mesh)
    middle = ((places[:, :2] > INNER[0]) & (places[:, :2] < INNER[1])).all(axis=1)
    return np.abs(colors - paint(places[:, 0], places[:, 1])).max(axis=1)[middle]


def test_a_wall_shows_the_colours_of_its_photos():
    found = texture(wall(), photos(), format="png")
    assert np.median(measure_errors(found.mesh)) < 2.5
    assert np.quantile(measure_errors(found.mesh), 0.99) < 8
    assert found.coverage_ratio > 0.95
    assert found.mesh.colors is None
    assert len(found.photos) == 12
    assert found.skipped == ()


def test_photos_without_depth_are_sufficient():
    found = texture(wall(), photos(with_depth=False), format="png")
    assert np.quantile(measure_errors(found.mesh), 0.95) < 8


def test_equal_input_gives_equal_bytes():
    first, second = texture_wall(6), texture(wall(), photos(6))
    assert [image.file_bytes for image in first.mesh.texture.images] == [
        image.file_bytes for image in second.mesh.texture.images
    ]
    assert np.array_equal(first.mesh.texture.uvs, second.mesh.texture.uvs)


def test_exact_photos_are_not_shifted():
    # A single image would also get additional detail; see test_back_projection.py.
    painted, looked_at = (
        texture(wall(), photos(4), max_size=128, alignment_iterations=iterations) for iterations in (0, 1)
    )
    assert 0 < looked_at.shift_ratio < 0.3 / 640
    assert len(painted.sizes) > 1
    for one, other in zip(painted.mesh.texture.images, looked_at.mesh.texture.images, strict=True):
        assert one.file_bytes == other.file_bytes
    assert looked_at.seam_ratio == painted.seam_ratio
    for one, other in zip(painted.labels, looked_at.labels, strict=True):
        assert np.array_equal(one, other)


def test_results_do_not_depend_on_the_photo_cache_size(monkeypatch: pytest.MonkeyPatch):
    whole = texture_wall(6)
    monkeypatch.setattr(photos_module, "_MAX_CACHE_BYTES", 0)
    monkeypatch.setattr(photos_module, "_LARGE_PHOTO_PIXELS", 0)
    monkeypatch.setattr(photo_survey, "_BATCH_POINTS", 1_000)
    found = texture(wall(), photos(6))
    assert photos_module.load_photos(photos(6), ignore_progress).cached == {}
    assert [image.file_bytes for image in found.mesh.texture.images] == [
        image.file_bytes for image in whole.mesh.texture.images
    ]


@pytest.mark.slow
def test_only_photos_that_may_show_a_part_are_sampled(monkeypatch: pytest.MonkeyPatch):
    # Close-ups that show a part of the wall each.
    places = [(x, y) for x in (0.2, 0.4, 0.6, 0.8) for y in (0.2, 0.4, 0.6, 0.8)]
    frames = [photo(number, pose(x, y, z=-0.3)) for number, (x, y) in enumerate(places)]
    at_once = texture(wall(40), frames, format="png", alignment_iterations=0)
    asked = []

    def watched(*given, photo_indices=None, **named):
        asked.append(photo_indices)
        return sample_photos(*given, photo_indices=photo_indices, **named)

    monkeypatch.setattr(photo_painting, "sample_photos", watched)
    monkeypatch.setattr(photo_painting, "_MIN_BATCH_BYTES", 6e6)
    monkeypatch.setattr(photo_painting, "_BATCH_BYTES", 6e6)
    monkeypatch.setattr(photo_painting, "_SINGLE_BATCH_BYTES", 6e6)
    found = texture(wall(40), frames, format="png", alignment_iterations=0)
    assert len(asked) > 3
    assert sum(0 < len(numbers) < len(frames) for numbers in asked) > len(asked) / 2
    # Positions are stored in single precision relative to the start of their part.
    same = [one == other for one, other in zip(at_once.labels, found.labels, strict=True)]
    assert np.mean(np.concatenate([one.ravel() for one in same])) > 0.999
    assert np.quantile(np.abs(sample_colors(found.mesh)[0] - sample_colors(at_once.mesh)[0]), 0.999) <= 1


@pytest.mark.slow
def test_exposures_of_photos_are_equalised():
    gains = np.array([0.8, 1.25, 1.0, 0.9, 1.1, 1.0] * 2)
    frames = [change_exposure(frame, gain, 3.0) for frame, gain in zip(photos(), gains, strict=True)]
    found = texture(wall(), frames, format="png")
    assert found.difference_after < 0.5 * found.difference_before
    # Only ratios can be estimated: a common gain and bias remains. Very bright values were clipped.
    colors, places = sample_colors(found.mesh)
    truth = paint(places[:, 0], places[:, 1])
    usable = (np.abs(places[:, :2] - 0.5) < 0.3).all(axis=1) & (truth.max(axis=1) < 190)
    for k in range(3):
        line = np.polyfit(colors[usable, k], truth[usable, k], 1)
        assert np.median(np.abs(np.polyval(line, colors[usable, k]) - truth[usable, k])) < 2
    plain = texture(wall(), frames, format="png", exposure=False)
    assert plain.gain_range == (1.0, 1.0)
    assert np.median(measure_errors(plain.mesh)) > np.median(measure_errors(found.mesh))


@pytest.mark.slow
def test_passers_by_are_not_painted():
    frames = photos(20, with_depth=False)
    for number in (4, 14):
        image = np.array(frames[number].color)
        image[30:110, 60:110] = (250, 20, 240)
        frames[number] = replace(frames[number], color=image)
    clean = texture(wall(), photos(20, with_depth=False), format="png").mesh
    walked = texture(wall(), frames, format="png").mesh
    off = np.abs(sample_colors(walked)[0] - sample_colors(clean)[0]).max(axis=1)
    assert np.mean(off > 10) <= 0.01


@pytest.mark.slow
def test_occluders_are_not_painted_on_the_background():
    # A white card in front of the wall, in the mesh and in every photo.
    def with_card(frame: Frame) -> Frame:
        x, y, depth = intersect_plane(np.asarray(frame.world_from_camera), z=-0.3)
        card = (np.abs(x - 0.5) < 0.1) & (np.abs(y - 0.5) < 0.1)
        image = np.where(card[..., None], 240, np.array(frame.color)).astype(np.uint8)
        return replace(
            frame, color=image, depth=np.where(card, depth, np.array(frame.depth)).astype(np.float32)
        )

    frames = [with_card(frame) for frame in photos(16)]
    back = wall()
    card = np.array([[0.4, 0.4, -0.3], [0.6, 0.4, -0.3], [0.6, 0.6, -0.3], [0.4, 0.6, -0.3]])
    both = Mesh(
        np.concatenate([back.vertices, card]),
        np.concatenate([back.triangles, len(back.vertices) + np.array([[0, 2, 1], [0, 3, 2]], np.int32)]),
    )
    painted = texture(both, frames, format="png")
    on_card, _ = sample_colors(painted.mesh, np.arange(len(back.triangles), len(both.triangles)))
    assert np.median(on_card) == pytest.approx(240, abs=2)
    # The same for a mesh without the card: depth shows that the photos do not see the wall there.
    for mesh in (painted.mesh, texture(back, frames, format="png").mesh):
        colors, places = sample_colors(mesh, np.arange(len(back.triangles)))
        off = np.abs(colors - paint(places[:, 0], places[:, 1])).max(axis=1)
        near = (np.abs(places[:, :2] - 0.5) < 0.25).all(axis=1)
        assert np.mean(off[near] > 30) < 0.02


@cache
def make_misplaced_photos() -> tuple[Frame, ...]:
    """Displace photos by two pixels, each in a different direction."""
    frames = []
    for number, frame in enumerate(photos(12)):
        angle = 2 * np.pi * number / 12
        moved = np.array(frame.world_from_camera)
        moved[:3, 3] += 0.8 * 2 / CAMERA.fx * np.array([np.cos(angle), np.sin(angle), 0])
        frames.append(replace(frame, world_from_camera=moved))
    return tuple(frames)


@pytest.mark.slow
def test_misplaced_photos_are_aligned():
    still, shifted = (
        texture(wall(), make_misplaced_photos(), format="png", alignment_iterations=iterations)
        for iterations in (0, 1)
    )
    assert 0.2 / CAMERA.width < shifted.shift_ratio < 3 / CAMERA.width
    assert np.median(measure_errors(shifted.mesh)) < 0.8 * np.median(measure_errors(still.mesh))


@pytest.mark.slow
def test_shifts_of_large_photos_are_estimated_at_lower_resolution(monkeypatch: pytest.MonkeyPatch):
    whole = texture(wall(), make_misplaced_photos(), format="png")
    monkeypatch.setattr(photo_painting, "_MAX_CORRECTION_PIXELS", 10_000)
    found = texture(wall(), make_misplaced_photos(), format="png")
    assert found.shift_ratio == pytest.approx(whole.shift_ratio, rel=0.25)
    assert np.median(measure_errors(found.mesh)) < 1.15 * np.median(measure_errors(whole.mesh))


def test_surface_without_photos_keeps_its_vertex_colours():
    frames = [photo(number, pose(0.3, 0.5, z=-0.5)) for number in range(3)]
    mesh = wall(50)
    own = paint(mesh.vertices[:, 0], mesh.vertices[:, 1])
    found = texture(mesh.with_(colors=np.rint(own).astype(np.uint8)), frames, format="png")
    assert 0.1 < found.coverage_ratio < 0.6
    colors, places = sample_colors(found.mesh)
    unseen = places[:, 0] > 0.7
    off = np.abs(colors - paint(places[:, 0], places[:, 1]))[unseen]
    assert np.median(off) < 15
    bare = texture(mesh, frames)
    assert "has no vertex colours" in str(bare.diagnostics[0])


@pytest.mark.slow
def test_texels_are_as_fine_as_the_photos():
    found = texture(wall(), photos(), texels_per_pixel=1.0)
    # At a distance of 0.8 m a pixel is 0.8 / 150 m wide.
    assert found.texel_size == pytest.approx(0.8 / 150, rel=0.25)
    fine = texture(wall(), photos(), texels_per_pixel=2.0)
    assert fine.texel_size == pytest.approx(found.texel_size / 2, rel=0.05)


def test_the_number_of_images_follows_the_size_limit():
    found = texture(wall(), photos(6), texels_per_pixel=2.0, max_size=128)
    assert len(found.sizes) > 1
    assert all(max(size) <= 128 for size in found.sizes)
    assert np.quantile(measure_errors(found.mesh), 0.95) < 15
    coarse = texture(wall(), photos(6), texels_per_pixel=2.0, max_size=128, max_texels=0.02)
    assert sum(w * h for w, h in coarse.sizes) < 0.05e6
    assert coarse.texel_size > found.texel_size


@pytest.mark.parametrize("name", ["wall.glb", "wall.obj", "wall.ply"])
@pytest.mark.parametrize("kind", ["jpeg", "webp", "png"])
def test_every_format_stores_the_texture(name, kind, tmp_path):
    found = texture_wall(6, kind)
    if (name, kind) == ("wall.ply", "webp"):
        return
    write_mesh(tmp_path / name, found.mesh)
    again = read_mesh(tmp_path / name)
    assert np.quantile(measure_errors(again), 0.95) < 12


def test_maps_show_the_dominant_photo(tmp_path):
    found = texture_wall(6)
    write_maps(tmp_path, found)
    maps = {path.stem: cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in tmp_path.glob("*.png")}
    assert set(maps) == {"count-1", "photo-1", "obliquity-1", "texel-1"}
    assert found.labels[0].max() < 6
    shown = found.labels[0] >= 0
    assert np.array_equal(maps["photo-1"], found.labels[0] + 1)
    assert found.photo_counts[0][shown].min() >= 1
    # No photo is rotated by more than 15°, and none sees much beyond 35° from its axis.
    assert maps["obliquity-1"][shown].max() < 60
    assert (maps["obliquity-1"][~shown] == 255).all()
    assert np.median(maps["texel-1"][shown]) == pytest.approx(1e6 * found.texel_size, rel=0.05)
    named = json.loads((tmp_path / "photos.json").read_text())
    assert named["photos"]["1"] == "000"


def test_maps_do_not_depend_on_the_batch_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    found, written = texture_wall(6), []
    for name, at_once in (("all", provenance_maps._BATCH_TEXELS), ("few", 997)):
        monkeypatch.setattr(provenance_maps, "_BATCH_TEXELS", at_once)
        (tmp_path / name).mkdir()
        write_maps(tmp_path / name, found)
        written.append({file.name: file.read_bytes() for file in (tmp_path / name).iterdir()})
    assert len(written[0]) == 5
    assert written[0] == written[1]


def test_progress_never_decreases():
    told = []
    texture(wall(), photos(6), progress=lambda done, total: told.append((done, total)))
    assert told == sorted(told)
    assert told[-1] == (1000, 1000)
    assert {total for _, total in told} == {1000}


def test_unusable_photos_are_skipped_and_counted():
    frames = photos(8)
    frames[1] = replace(frames[1], color=np.zeros((120, 160, 3), np.uint8))
    frames[2] = replace(frames[2], color=np.full((120, 160, 3), 255, np.uint8))
    frames[3] = replace(frames[3], color=np.full((160, 120, 3), 128, np.uint8))
    frames[4] = replace(frames[4], world_from_camera=pose(9.0, 9.0))
    rng = np.random.default_rng(0)
    frames[5] = replace(frames[5], color=rng.integers(0, 255, (120, 160, 3), np.uint8))
    found = texture(wall(), frames, format="png")
    reasons = {one.name: one.reason for one in found.skipped}
    assert sorted(reasons) == ["001", "002", "003", "004", "005"]
    assert "black or white" in reasons["001"]
    assert "black or white" in reasons["002"]
    assert "120×160" in reasons["003"]
    assert "does not show the mesh" in reasons["004"]
    assert "contradicts the others" in reasons["005"]
    assert np.median(measure_errors(found.mesh)) < 4


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([Frame("0", CAMERA, world_from_camera=np.eye(4))], "none of the 1 frames has a colour image"),
        ([replace(photos(1)[0], world_from_camera=None)], "none of the 1 photos can be used"),
        ([photo(0, pose(50.0, 50.0))], "none of the 1 photos shows the mesh|black or white"),
        ([], "none of the 0 frames"),
    ],
)
def test_unusable_scans_are_one_sentence(frames, message):
    with pytest.raises(InputError, match=message):
        texture(wall(), Scan("made", frames))


def test_invalid_parameters_and_meshes_are_refused():
    with pytest.raises(UsageError, match="power of two"):
        texture(wall(), photos(1), max_size=100)
    with pytest.raises(MeshError, match="zero area"):
        texture(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)), photos(1))


def test_pixels_beyond_the_border_of_a_distorted_photo_are_not_used():
    # Undistorting this lens leaves black corners.
    lens = replace(CAMERA, distortion=(0.45, 0.0, 0.0, 0.0))
    frames = [replace(frame, color_camera=lens) for frame in photos(12)]
    image, camera, seen = read_photo(frames[0])
    assert camera.distortion == ()
    assert not seen.all()
    assert np.mean(image[~seen] == 0) > 0.9
    for frame in frames:
        assert read_photo(frame)[2] is not None
    white = [replace(frame, color=np.full_like(np.asarray(frame.color), 200)) for frame in frames]
    colors, _ = sample_colors(texture(wall(), white, format="png").mesh)
    assert colors.min() > 195


def test_surface_seen_only_obliquely_gets_photo_colours():
    flat = make_grazing_photo(0)
    grey = wall(colors=np.full((13 * 13, 3), 128, np.uint8))
    found = texture(grey, [flat], format="png")
    assert found.coverage_ratio > 0.5
    assert found.diagnostics == ()
    colors, places = sample_colors(found.mesh)
    truth = paint(places[:, 0], places[:, 1])
    # Across the wall pixels cover 5 cm, along the other axis they are as fine as usual.
    near = (places[:, 0] > 0.6) & (places[:, 0] < 0.85) & (np.abs(places[:, 1] - 0.5) < 0.15)
    assert np.abs(colors - truth)[near].mean() < 0.4 * np.abs(128 - truth)[near].mean()


@pytest.mark.slow
def test_an_oblique_photo_is_not_used_where_others_are_frontal():
    frames, mesh = photos(), wall()
    flat = replace(make_grazing_photo(12), color=np.full((120, 160, 3), 200, np.uint8))
    without, beside = (
        texture(mesh, some, format="png", alignment_iterations=0) for some in (frames, [*frames, flat])
    )
    for share in (0.5, 0.9, 0.99):
        off = [np.quantile(measure_errors(one.mesh), share) for one in (without, beside)]
        assert off[1] == pytest.approx(off[0], abs=0.2)
    assert beside.difference_after == pytest.approx(without.difference_after, abs=0.2)
    assert beside.coverage_ratio >= without.coverage_ratio
