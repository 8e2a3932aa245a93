import math
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
import trimesh

from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.rendering.render import RenderModel, render, write_png
from scanloom.stages.rendering.viewpoints import Viewpoint, viewpoints
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture
from scanloom.stages.surface.raycasting import RaycastingSurface

CAMERA = Camera(80, 60, 70.0, 70.0, 39.5, 29.5)
AHEAD = Viewpoint("ahead", CAMERA, np.eye(4))


def make_quad(depth: float, colors=None, half: float = 3.0) -> Mesh:
    """Make a square perpendicular to the optical axis at a depth, facing the camera at the origin."""
    vertices = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]) + (0, 0, depth)
    triangles = np.array([[0, 2, 1], [0, 3, 2]], np.int32)
    return Mesh(vertices, triangles, None if colors is None else np.uint8(colors))


def ball(center, radius: float) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return Mesh(np.asarray(made.vertices) + center, np.asarray(made.faces, np.int32))


def mask_background(image: np.ndarray) -> np.ndarray:
    empty = render(make_quad(-5), AHEAD)
    return (image == empty).all(axis=2)


def test_an_image_has_the_size_of_the_view_and_a_light_background():
    image = render(make_quad(-5), AHEAD)
    assert image.shape == (60, 80, 3)
    assert image.dtype == np.uint8
    assert image.min() > 200


def test_colours_and_sides_are_kept():
    # Left red, right blue.
    image = render(make_quad(2, [[250, 0, 0], [0, 0, 250], [0, 0, 250], [250, 0, 0]], half=1), AHEAD).astype(
        int
    )
    left, right = image[30, 8], image[30, 71]
    assert left[0] > 180 > 60 > left[2]
    assert right[2] > 180 > 60 > right[0]
    assert abs(image[30, 39, 0] - image[30, 39, 2]) < 12


def test_a_texture_is_drawn_pixel_by_pixel():
    # Red, green; blue, white: finer than the corner colours of two triangles could represent.
    pixels = np.uint8([[[250, 0, 0], [0, 250, 0]], [[0, 0, 250], [250, 250, 250]]]).repeat(8, 0).repeat(8, 1)
    mesh = make_quad(2, [[0, 0, 0]] * 4, half=1)
    # Camera axes: y points down, like image rows, and v points up.
    at = (mesh.vertices[mesh.triangles][..., :2] + 1) / 2
    uvs = np.stack([at[..., 0], 1 - at[..., 1]], axis=-1)
    texture = Texture(uvs, np.zeros(2, np.int32), (Material(image=Image(given=pixels)),))
    image = render(mesh.with_(texture=texture), AHEAD).astype(int)
    upper_left, upper_right, lower_left, lower_right = (
        image[12, 22],
        image[12, 56],
        image[46, 22],
        image[46, 56],
    )
    assert upper_left.argmax() == 0
    assert upper_right.argmax() == 1
    assert lower_left.argmax() == 2
    assert lower_right.min() > 180
    for color in (upper_left, upper_right, lower_left):
        assert np.sort(color)[1] < 20


def test_a_sphere_covers_the_cone_of_its_silhouette():
    distance, radius = 4.0, 1.0
    image = render(ball((0, 0, distance), radius), AHEAD, shading="plain")
    # The silhouette is a circle of angle asin(r / d) around the axis.
    pixels = math.pi * (CAMERA.fx * math.tan(math.asin(radius / distance))) ** 2
    assert (~mask_background(image)).sum() == pytest.approx(pixels, rel=0.06)
    rows, columns = np.nonzero(~mask_background(image))
    assert [rows.mean(), columns.mean()] == pytest.approx([29.5, 39.5], abs=0.1)


def test_pose_and_principal_point_position_the_image():
    world_from_camera = np.eye(4)
    world_from_camera[:3, 3] = (10, -4, 2)
    camera = Camera(80, 60, 70.0, 70.0, 20.0, 45.0)
    image = render(ball((10, -4, 6), 0.3), Viewpoint("moved", camera, world_from_camera))
    rows, columns = np.nonzero(~mask_background(image))
    assert [rows.mean(), columns.mean()] == pytest.approx([45, 20], abs=0.3)


def test_the_nearer_surface_hides_the_farther():
    near, far = make_quad(2, [[0, 200, 0]] * 4, half=0.2), make_quad(3, [[200, 0, 0]] * 4)
    both = Mesh(
        np.vstack([far.vertices, near.vertices]),
        np.vstack([far.triangles, near.triangles + 4]),
        np.vstack([far.colors, near.colors]),
    )
    image = render(both, AHEAD).astype(int)
    assert image[30, 40, 1] > image[30, 40, 0] + 100
    assert image[5, 5, 0] > image[5, 5, 1] + 100


def test_culling_shows_a_room_from_outside():
    room = trimesh.creation.box(extents=(2, 2, 2))
    inward = Mesh(np.asarray(room.vertices) + np.array((0, 0, 5)), np.asarray(room.faces[:, ::-1], np.int32))
    side = 70 * 2 / 6  # side = 70 * 2 / 6 pixels of the far wall; the near wall, at 4 m, is larger
    near, far = (
        (~mask_background(render(inward, Viewpoint("v", CAMERA, np.eye(4), cull), shading="plain")))[30].sum()
        for cull in (False, True)
    )
    assert near == pytest.approx(70 * 2 / 4, abs=1)
    assert far == near  # the side walls now fill the difference
    open_room = inward.with_(
        triangles=inward.triangles[np.ptp(inward.vertices[inward.triangles, 2], axis=1) == 0]
    )
    image = render(open_room, Viewpoint("v", CAMERA, np.eye(4), cull=True), shading="plain")
    assert (~mask_background(image))[30].sum() == pytest.approx(side, abs=1)


def test_edges_are_drawn_at_their_positions():
    image = render(make_quad(2, half=0.6), AHEAD, shading="edges").mean(axis=2)
    flat = render(make_quad(2, half=0.6), AHEAD, shading="plain").mean(axis=2)
    corner, middle = (29.5 - 70 * 0.3, 39.5 - 70 * 0.3), (29.5, 39.5)
    on_diagonal = [round((a + b) / 2) for a, b in zip(corner, middle, strict=True)]
    assert image[on_diagonal[0], on_diagonal[1]] < flat[on_diagonal[0], on_diagonal[1]] - 40
    inside = (30 + 12, 40 - 4)
    assert image[inside] == pytest.approx(flat[inside], abs=2)


def test_a_back_face_is_tinted():
    front, back = make_quad(2), make_quad(2).with_(triangles=make_quad(2).triangles[:, ::-1])
    seen = [render(mesh, AHEAD, shading="plain")[30, 40].astype(int) for mesh in (front, back)]
    assert seen[0][0] >= seen[0][2]
    assert seen[1][2] > seen[1][0] + 15


def test_a_mesh_without_colours_is_clay_in_a_coloured_picture():
    np.testing.assert_array_equal(render(make_quad(2), AHEAD), render(make_quad(2), AHEAD, shading="plain"))


def test_map_coordinates_do_not_blur_the_image():
    shift = np.array((5e5, 5.4e6, 100.0))
    pose = np.eye(4)
    pose[:3, 3] = shift
    near, mesh = ball((0, 0, 4), 1.0), ball(shift + np.array((0, 0, 4)), 1.0)
    here = render(near, AHEAD, shading="edges").astype(int)
    there = render(mesh, Viewpoint("far", CAMERA, pose), shading="edges").astype(int)
    assert np.abs(here - there).mean() < 0.5


def test_no_triangles_is_an_error():
    empty = Mesh(np.zeros((3, 3)), np.zeros((0, 3), np.int32))
    with pytest.raises(InputError, match="no triangles"):
        render(empty, AHEAD)
    with pytest.raises(InputError, match="no triangles"):
        viewpoints(empty)


def test_a_png_holds_the_picture(tmp_path):
    image = render(make_quad(2, [[250, 0, 0], [0, 0, 250], [0, 0, 250], [250, 0, 0]]), AHEAD)
    write_png(tmp_path / "picture.png", image)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "picture.png"))[:, :, ::-1], image)
    assert [path.name for path in tmp_path.iterdir()] == ["picture.png"]


def test_a_png_that_cannot_be_written_is_an_error_with_its_path(tmp_path):
    with pytest.raises(StageError, match="absent"):
        write_png(tmp_path / "absent" / "picture.png", np.zeros((4, 4, 3), np.uint8))


def test_an_outline_pixel_has_the_mean_of_the_covered_colours():
    # The left side of the square passes through the middle of a pixel, which is half background.
    image = render(make_quad(2, [[0, 0, 0]] * 4, half=2 * 20 / 70), AHEAD).astype(float)
    inside, edge, outside = image[30, 21, 0], image[30, 19:21, 0].mean(), image[30, 18, 0]
    assert inside < 5
    assert edge == pytest.approx((inside + outside) / 2, rel=0.15)


def test_threads_draw_the_same_picture():
    model = RenderModel(RaycastingSurface(ball((0, 0, 4), 1.0)))
    with ThreadPoolExecutor(4) as pool:
        images = list(pool.map(lambda _: model.draw(AHEAD, "edges"), range(8)))
    for image in images:
        np.testing.assert_array_equal(image, images[0])


def test_default_views_show_the_whole_mesh_with_y_up():
    mesh = ball((3, 1, -7), 0.25)
    mesh = mesh.with_(vertices=mesh.vertices * (1, 2, 1))
    views = viewpoints(mesh, 5, width=200)
    assert len({viewpoint.name for viewpoint in views}) == 5
    for viewpoint in views:
        projected, depth = project_points(viewpoint, mesh.vertices)
        assert depth.min() > 0
        assert projected.min() >= 0
        assert (projected.max(axis=0) < (200, 150)).all()
        # The mesh fills most of one image side.
        assert (np.ptp(projected, axis=0) / (200, 150)).max() > 0.85
        assert viewpoint.world_from_camera[1, 1] < -0.5
        assert np.linalg.det(viewpoint.world_from_camera[:3, :3]) == pytest.approx(1)


def project_points(viewpoint: Viewpoint, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    seen = (points - viewpoint.world_from_camera[:3, 3]) @ viewpoint.world_from_camera[:3, :3]
    return (seen / seen[:, 2:]) @ viewpoint.camera.matrix.T[:, :2], seen[:, 2]


def test_frames_of_a_scan_give_an_overview_and_the_sensors_own_views():
    camera = Camera(640, 480, 585.0, 585.0, 320.0, 240.0, (0.1, 0.0, 0.0, 0.0))
    frames = [Frame(str(i), camera, world_from_camera=make_level_pose(10 * i)) for i in range(9)]
    frames.insert(4, Frame("lost", camera))
    mesh = ball((0, 0, 0), 0.5)
    views = viewpoints(mesh, 4, frames=frames, width=320)
    assert [viewpoint.name for viewpoint in views] == ["overview", "frame-1", "frame-4", "frame-7"]
    assert [viewpoint.cull for viewpoint in views] == [True, False, False, False]
    np.testing.assert_array_equal(views[2].world_from_camera, frames[5].world_from_camera)
    # Half resolution: (c + 1/2) / 2 - 1/2, with pixel centres at integers.
    assert views[1].camera == Camera(320, 240, 292.5, 292.5, 159.75, 119.75)
    overview = views[0].world_from_camera
    assert overview[2, 1] < -0.8, "z is up in this scan, so the picture's y goes down in z"
    assert overview[2, 3] > 0.3, "the overview looks from above"


def make_level_pose(azimuth_degrees: float) -> np.ndarray:
    """Make the pose of a level camera 3 m from the origin that faces the origin, z up."""
    a = math.radians(azimuth_degrees)
    forward = -np.array((math.cos(a), math.sin(a), 0))
    down = np.array((0, 0, -1.0))
    pose = np.eye(4)
    pose[:3] = np.stack([np.cross(down, forward), down, forward, -3 * forward], axis=1)
    return pose
