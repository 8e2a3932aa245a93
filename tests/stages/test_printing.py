"""Results print as one or two lines without arrays; in a notebook as a table with a picture."""

import base64
import re
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pytest

from scanloom import Page, show, stages
from scanloom.stages import Camera, Frame, Image, Material, Mesh, Registration, Scan, StereoRig, Texture, lod
from scanloom.stages.printing import format_line
from scanloom.stages.scans.model.scan import PackedImage, SkippedFrame
from scanloom.stages.surface import thumbnail
from scanloom.stages.surface.codes import MESH_LEFT_OUT

CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)


def ball(subdivisions: int = 2) -> Mesh:
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    colors = np.clip(128 + 100 * mesh.vertices, 0, 255).astype(np.uint8)
    return Mesh(np.array(mesh.vertices), np.array(mesh.faces, np.int32), colors)


def make_textured_mesh() -> Mesh:
    square = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]], np.int32))
    red = Image("red.png", given=np.full((4, 4, 3), (200, 0, 0), np.uint8))
    uvs = np.array([[[0, 0], [1, 0], [0, 1.0]]])
    return square.with_(texture=Texture(uvs, np.zeros(1, np.int32), (Material("paint", red),)))


def make_mesh_with_image(image: Image) -> Mesh:
    mesh = make_textured_mesh()
    return mesh.with_(texture=replace(mesh.texture, materials=(Material("paint", image),)))


def frames(count: int = 4) -> list[Frame]:
    """Make frames of a wall with a step, 1 m away."""
    depth = np.full((48, 64), 1.0, np.float32)
    depth[:, 30:40] = 0.9
    color = np.full((48, 64, 3), 90, np.uint8)
    poses = [np.eye(4) for _ in range(count)]
    for i, pose in enumerate(poses):
        pose[0, 3] = 0.01 * i
    return [Frame(f"{i}", CAMERA, color, depth=depth, world_from_camera=p) for i, p in enumerate(poses)]


def export_mesh(mesh: Mesh) -> stages.ExportResult:
    with TemporaryDirectory() as folder:
        return stages.export(mesh, Path(folder) / "a.glb", stages.preset("web"))


def simulate(mesh: Mesh) -> stages.SimulationResult:
    with TemporaryDirectory() as folder:
        return stages.export_simulation(mesh, Path(folder) / "model")


def build_registration() -> Registration:
    """Build a result of register; a real registration needs frames with more structure than a wall."""
    edge = {"source": 0, "target": 1, "fitness": 0.8, "rmse_m": 0.002, "is_loop": False, "is_used": True}
    names = tuple(frame.name for frame in frames())
    dark = MESH_LEFT_OUT.warning("too dark")
    lost = (SkippedFrame("9", dark),)
    apart = {2: {9: frames(1)[0]}}
    return Registration(
        *(tuple(frames()), (0, 1, 2, 3), lost, (names, ("9",)), apart, (edge,) * 3, lost, (0,)),
        seconds=1.5,
        diagnostics=(dark,),
    )


def build_structure() -> stages.Structure:
    """Build a result of structure; a real one needs photos and an optional dependency."""
    return stages.Structure(
        frames=tuple(frames()),
        frame_indices=(0, 1, 2, 3),
        other_groups=(("7", "8"),),
        unconnected=("9",),
        skipped=(),
        points=np.zeros((5, 3)),
        colors=np.zeros((5, 3), np.uint8),
        candidate_pairs=10,
        verified_pairs=6,
        reprojection_error_px=0.7,
        model=None,
        seconds=1.5,
        diagnostics=(MESH_LEFT_OUT.warning("two photos do not connect"),),
    )


def simplify_with_each_method(mesh: Mesh) -> list[object]:
    """Simplify with each method; return the results, their details, a record and a replay."""
    bounds = {"certified": {"max_shape": 0.1}, "jia01": {}, "planar": {}}
    methods = ("quadric", "certified", "seams", "jia01", "planar")
    found = [stages.simplify(mesh, method=name, **bounds.get(name, {"ratio": 0.5})) for name in methods]
    record = stages.simplify(mesh, ratio=0.5, record=True).record
    return [*found, *(one.details for one in found), record, record.replay(ratio=0.8)]


def make_all_results():
    """Make an instance of every public class except parameters and errors, by quick real calls."""
    mesh, scan = ball(), Scan("made", frames())
    far = Camera(640, 480, 525.123456789, 525.1, 319.5, 239.5, tuple(np.linspace(0.1, 1.4, 14) / 3))
    rig = StereoRig(CAMERA, CAMERA, np.eye(4), is_rectified=True)
    left = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 255, (96, 160, 3), np.uint8), (3, 3), 0)
    wide = Camera(128, 96, 100.0, 100.0, 63.5, 47.5)
    shifted = np.eye(4)
    shifted[0, 3] = -0.1
    pair = (np.ascontiguousarray(left[:, 8:136]), np.ascontiguousarray(left[:, 16:144]))
    remeshed = stages.remesh(mesh, levels=1, base_triangles=20)
    comparison = stages.compare(mesh, mesh, samples=1000)
    views = stages.compare_views(mesh, mesh, views=1, view_width=64)
    points = Mesh(mesh.vertices, mesh.triangles[:0])
    cleaned = stages.clean(mesh)
    inspected = stages.inspect(scan)
    fused = stages.fuse(scan, voxel_size=0.02, min_weight=1)
    return [
        mesh,
        make_textured_mesh(),
        *(
            make_textured_mesh().texture,
            make_textured_mesh().texture.materials[0],
            make_textured_mesh().texture.images[0],
        ),
        Image("photo.jpg", encoded=b"\xff\xd8\xff" * 1000),
        Material("grey", base_color=(0.5, 0.5, 0.5, 1.0)),
        scan,
        replace(
            scan,
            frames=frames(0),
            missing=(MESH_LEFT_OUT.warning("poses: none"), MESH_LEFT_OUT.warning("x" * 400)),
            diagnostics=(MESH_LEFT_OUT.warning("odd"),),
        ),
        scan.frames[0],
        CAMERA,
        far,
        rig,
        PackedImage(Path("video.mp4"), "frame 3", lambda: np.zeros((1, 1))),
        fused,
        cleaned,
        cleaned.changes,
        comparison,
        comparison.symmetric,
        comparison.color,
        stages.certify(mesh, mesh),
        stages.check(mesh),
        lod.build(mesh),
        lod.build(mesh).cut(triangles=1),
        lod.View((0, 0, 0), (0, 0, 1)),
        stages.repair(mesh),
        remeshed,
        remeshed.offsets[0],
        stages.bake(ball(1), mesh, max_size=64),
        build_registration(),
        stages.adjust(scan),
        stages.texture(fused.mesh, scan),
        stages.refine(fused.mesh, scan),
        build_structure(),
        stages.depth(*pair, StereoRig(wide, wide, shifted, is_rectified=True), disparities=16),
        stages.stereo_disparity(*pair, 15),
        inspected,
        inspected.trajectory,
        inspected.depth,
        stages.topology(mesh),
        *simplify_with_each_method(mesh),
        stages.planar_patches(mesh),
        stages.Sphere((0, 0, 1.5), 0.25, importance=20.0),
        stages.Box((0, 0, 0), (1, 1, 1), lock=True),
        stages.viewpoints(mesh)[0],
        export_mesh(mesh),
        simulate(ball(1)),
        stages.align(mesh, mesh)[1],
        stages.deviations(mesh, mesh),
        stages.changes(mesh, mesh),
        views,
        views.worst,
        stages.compare(mesh, points, samples=100),
        stages.compare(mesh, points, samples=100).clouds[1],
        (curve := stages.tradeoff(mesh, counts=(200, 100, 50), samples=1000)),
        curve.points[0],
        show(mesh, page_size=2),
        # The whole mesh was seen at an angle above this limit.
        (missing := stages.coverage(fused.mesh, scan, max_angle=1.0, few_frames=100, min_area=1e-4)),
        missing.defects[0],
        MESH_LEFT_OUT.warning("colours are left out", "a.stl"),
    ]


@pytest.fixture(scope="module")
def results():
    return make_all_results()


@pytest.mark.slow
def test_results_print_as_a_line_or_two_without_arrays(results):
    for result in results:
        text = repr(result)
        assert text.startswith(f"{type(result).__name__}(")
        assert len(text) <= 300, text
        assert len(text.splitlines()) <= 2, text
        assert not re.search(r"array\(|\[\[|dtype|object at|\(, |, ,|, \)", text), text


@pytest.mark.slow
def test_every_public_class_is_covered(results):
    names = {name for name in stages.__all__ if name[0].isupper()} - {"MeshLike", "Severity"}
    classes = {getattr(stages, name) for name in names}
    results_of = {
        cls for cls in classes if not issubclass(cls, Exception) and not cls.__name__.endswith("Params")
    }
    assert results_of <= {type(result) for result in results}


def test_a_mesh_prints_its_size():
    mesh = ball().with_(vertices=ball().vertices * (3.1, 2.05, 1.2))
    assert repr(mesh) == "Mesh(320 triangles, colours, 6.2 × 4.1 × 2.4 m)"
    assert repr(make_textured_mesh()) == "Mesh(1 triangle, 1 texture image, 1 × 1 × 0 m)"
    assert (
        repr(mesh.with_(vertices=mesh.vertices / 1000)) == "Mesh(320 triangles, colours, 6.2 × 4.1 × 2.4 mm)"
    )
    assert repr(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))) == "Mesh(no triangles)"
    parts = mesh.with_(
        part_ids=np.zeros(320, np.int32), part_names=("a", "b"), diagnostics=(MESH_LEFT_OUT.warning("said"),)
    )
    assert repr(parts) == "Mesh(320 triangles, colours, 2 parts, 6.2 × 4.1 × 2.4 m, 1 diagnostic)"


def test_a_result_prints_its_diagnostics():
    mesh = ball().with_(part_ids=np.zeros(320, np.int32), part_names=("a",))
    result = stages.simplify(mesh, ratio=0.5, method="quadric")
    assert repr(result).endswith(", 1 diagnostic)")
    table = result._repr_html_()
    assert "<th style='text-align:left'>warning</th><td>simplify discards parts; method seams" in table


def test_other_results_print_their_main_values(results):
    texts = {type(result).__name__: repr(result) for result in reversed(results)}
    assert texts["Scan"] == "Scan(made, 4 frames, colour and depth, poses)"
    assert texts["Frame"] == "Frame(0, 64 × 48 px, colour, depth, pose)"
    assert texts["Camera"] == "Camera(64 × 48 px, fx 60, fy 60, cx 31.5, cy 23.5 px)"
    assert texts["FusionResult"].startswith("FusionResult(")
    assert "voxel size 0.02 m" in texts["FusionResult"]
    assert "triangles" in texts["FusionResult"]
    assert texts["Texture"] == "Texture(1 triangle, 1 material, 1 image)"
    assert texts["Comparison"].startswith("Comparison(distance rms ")
    assert texts["Material"] == "Material(paint, Image(red.png, 4 × 4 px))"
    assert "shape bound" in texts["Certificate"]


def test_a_long_line_is_cut_between_facts():
    text = format_line(CAMERA, ["fact " * 20] * 9)
    assert text.endswith(", …)")
    assert len(text) <= 300


def extract_picture(html: str) -> np.ndarray | None:
    found = re.search(r"src='data:image/png;base64,([^']+)'", html)
    return None if found is None else cv2.imdecode(np.frombuffer(base64.b64decode(found[1]), np.uint8), 1)


def test_a_notebook_shows_a_table_and_a_picture(results):
    # A page is not shown as a table; tests/pipeline/report/page/test_show.py tests it.
    shown = [one for one in results if hasattr(one, "_repr_html_") and not isinstance(one, Page)]
    assert {
        "SimplificationResult",
        "Mesh",
        "FusionResult",
        "BakeResult",
        "NormalMesh",
        "Comparison",
        "Scan",
        "Frame",
    } <= {type(one).__name__ for one in shown}
    for result in shown:
        html = result._repr_html_()
        assert html.count("<tr>") >= 1
        assert type(result).__name__ in html
        assert len(html) < 200_000
        has_mesh = isinstance(getattr(result, "mesh", result), Mesh)
        has_photo = isinstance(result, Frame) or (isinstance(result, Scan) and len(result.frames) > 0)
        assert (extract_picture(html) is not None) == (has_mesh or has_photo), type(result)


def test_the_picture_shows_colours_texture_or_clay():
    def middle(mesh):
        return extract_picture(mesh._repr_html_())[80:100, 110:130].reshape(-1, 3).mean(axis=0)[::-1]

    red, green, blue = middle(make_textured_mesh())
    assert red > 60
    assert max(green, blue) < 10
    clay = middle(ball().with_(colors=None))
    assert np.ptp(clay) < 20
    assert clay.min() > 100
    towards = middle(ball())
    assert towards[1] > 128 > towards[0], "y is up, and x goes to the right behind the viewer"


def test_a_scan_shows_evenly_spread_photos():
    def solid(*levels: int) -> np.ndarray:
        return np.broadcast_to(np.array(levels, np.uint8), (30, 40, 3)).copy()

    colors = [solid(20 * k, 0, 0) for k in range(12)]
    shown = [replace(frame, color=color) for frame, color in zip(frames(12), colors, strict=True)]
    image = extract_picture(Scan("made", shown)._repr_html_())
    assert image.shape == (90, 480, 3)
    assert image[45, 60::120, 2].tolist() == [20, 80, 140, 200]
    one = extract_picture(replace(shown[3], right=solid(0, 0, 255))._repr_html_())
    assert one[45, 60].tolist() == [0, 0, 60]
    assert one[45, 180].tolist() == [255, 0, 0]


@pytest.mark.parametrize("color", [Path("missing.png"), np.zeros((0, 0, 3), np.uint8), None])
def test_a_frame_whose_photo_cannot_be_shown_is_still_a_table(color):
    html = replace(frames()[0], color=color)._repr_html_()
    assert "<th style='text-align:left'>size</th><td>64, 48 px</td>" in html
    assert "<img" not in html


@pytest.mark.parametrize(
    "mesh",
    [
        Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)),
        Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)),
        Mesh(np.full((3, 3), np.nan), np.array([[0, 1, 2]], np.int32)),
        Mesh(np.eye(3), np.array([[0, 1, 9]], np.int32)),
        make_textured_mesh().with_(
            texture=replace(
                make_textured_mesh().texture, materials=(Material("x", Image("x.png", encoded=b"no image")),)
            )
        ),
    ],
    ids=["empty", "point", "not finite", "out of range", "damaged image"],
)
def test_a_mesh_that_cannot_be_drawn_is_still_a_table(mesh):
    html = mesh._repr_html_()
    assert "<table>" in html
    assert "<img" not in html


def test_the_nearest_surface_is_drawn():
    # A small blue triangle in front of a large red one, from the direction of the picture.
    towards = thumbnail._VIEW_DIRECTION / np.linalg.norm(thumbnail._VIEW_DIRECTION)
    right = np.array((towards[2], 0, -towards[0]))
    up = np.cross(towards, right)
    corners = [np.cos(a) * right + np.sin(a) * up for a in np.radians((90, 210, 330))]
    vertices = np.array([*corners, *(0.5 * corner + towards for corner in corners)])
    colors = np.array([(255, 0, 0)] * 3 + [(0, 0, 255)] * 3, np.uint8)
    for order in ([[0, 1, 2], [3, 4, 5]], [[3, 4, 5], [0, 1, 2]]):
        image = thumbnail.render_thumbnail(vertices, np.array(order, np.int32), colors, None)
        assert image.shape == (180, 240, 3)
        assert (image == (0, 0, 255)).all(axis=2).sum() > 1000
        assert (image == (255, 0, 0)).all(axis=2).sum() > 1000
        assert tuple(image[95, 120]) == (0, 0, 255)


def test_names_do_not_become_markup():
    scan = Scan("<script>", frames())
    html = stages.inspect(scan)._repr_html_()
    assert "<script>" not in html
    assert "&lt;script&gt;" in html
