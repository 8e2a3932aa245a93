"""Commands `clean`, `simplify`, `compare`, `certify` and `render`: metrics, files, and bad input."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from scanloom.cli.output import format_size
from scanloom.stages.progress import Progress
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh

Run = Callable[..., Any]


def test_clean_removes_the_speck_and_keeps_the_colours(scanloom: Run, ball: Path, tmp_path: Path) -> None:
    target = tmp_path / "new" / "clean.ply"
    ran = scanloom("clean", ball, target, "--json")
    assert ran.exit_code == 0
    assert ran.stderr == ""
    assert ran.json["output"] == str(target)
    cleaned = read_mesh(target)
    assert len(cleaned.triangles) == 1280
    assert cleaned.colors is not None


def test_clean_repairs_defects_and_reports_the_remaining_ones(scanloom: Run, tmp_path: Path) -> None:
    source, target = tmp_path / "thin.ply", tmp_path / "out.ply"
    x, y = np.meshgrid(np.arange(6.0), np.arange(6.0))
    # Two close vertices in the interior, and two on the boundary.
    x[2, 3] = x[2, 2] + 0.005
    x[0, 3] = x[0, 2] + 0.005
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    a = (np.arange(5)[:, None] * 6 + np.arange(5)).ravel()
    triangles = np.concatenate([np.stack(t, 1) for t in ((a, a + 1, a + 7), (a, a + 7, a + 6))])
    write_ply(source, Mesh(vertices, triangles.astype(np.int32)))
    ran = scanloom("clean", source, target, "--repair", "--set", "clean.max_shape=0.01", "--json")
    assert ran.exit_code == 0
    metrics = ran.json["repair"]
    needles = metrics["classes"]["needles"]
    assert (needles["found"], needles["repaired"], needles["left"]) == (3, 2, 1)
    assert needles["reasons"] == {"at a border": 1}
    assert metrics["bound_m"] <= metrics["max_shape_m"] == 0.01
    assert len(read_mesh(target).vertices) == 35
    assert "1 of 3 needles not repaired: 1 at a border; the first at (" in ran.stderr
    ran = scanloom("clean", source, target, "--repair", "--set", "clean.repair_angle=0.1")
    assert re.search(r"^repair bound +0 m$", ran.stdout, re.M)
    assert "needles" not in ran.stdout


def test_jia01_keeps_within_its_shape_bound(scanloom: Run, ball: Path, tmp_path: Path) -> None:
    clean, light = tmp_path / "clean.ply", tmp_path / "light.ply"
    scanloom("clean", ball, clean)
    ran = scanloom("simplify", clean, light, "--method", "jia01", "--max-shape", 0.05, "--triangles", 300)
    assert ran.exit_code == 0, ran.stderr
    metrics = scanloom("compare", clean, light, "--set", "compare.samples=20000", "--json").json
    assert metrics["distance"]["symmetric"]["maximum_m"] <= 0.05
    assert 4 <= len(read_mesh(light).triangles) < 1280


def test_certify_confirms_the_bounds_proven_by_simplify(scanloom: Run, ball: Path, tmp_path: Path) -> None:
    clean, light = tmp_path / "clean.ply", tmp_path / "light.ply"
    scanloom("clean", ball, clean)
    bounds = ("--max-shape", 0.05, "--max-color", 20)
    ran = scanloom("simplify", clean, light, *bounds)
    assert ran.exit_code == 0, ran.stderr
    assert re.search(r"^Proven: no point is more than 0\.0\d+ m and [\d.]+ levels off\.$", ran.stdout, re.M)
    metrics = scanloom("simplify", clean, light, *bounds, "--json").json
    assert metrics["details"]["proven"] is True
    assert metrics["details"]["shape_bound_m"] <= 0.05
    assert metrics["details"]["color_bound_levels"] <= 20
    assert len(read_mesh(light).triangles) < 0.7 * 1280

    measured = scanloom("compare", clean, light, "--set", "compare.samples=20000", "--json").json
    again = scanloom("mesh", "certify", light, clean, "--json")
    assert again.exit_code == 0
    assert measured["distance"]["symmetric"]["maximum_m"] <= again.json["shape_bound_m"] <= 0.05
    assert measured["color"]["symmetric"]["maximum_levels"] <= again.json["color_bound_levels"] <= 20.2
    text = scanloom("mesh", "certify", light, clean).stdout
    assert "proven maximum" in text
    assert "colour difference levels" in text

    kept = scanloom("mesh", "certify", light, clean, "--max-shape", 0.05, "--max-color", 20)
    assert (kept.exit_code, kept.stderr) == (0, "")
    assert "The limits are proven." in kept.stdout
    broken = scanloom(
        "mesh", "certify", light, clean, "--max-shape", 0.9 * again.json["shape_attained_m"], "--json"
    )
    assert (broken.exit_code, broken.json["within_limits"]) == (1, False)


def test_simplify_stops_at_a_triangle_count_or_at_bounds(scanloom: Run, ball: Path, tmp_path: Path) -> None:
    clean, light = tmp_path / "clean.ply", tmp_path / "light.ply"
    scanloom("clean", ball, clean)
    ran = scanloom("simplify", clean, light, "--ratio", 0.7, "--max-shape", 0.05, "--json")
    assert ran.exit_code == 0, ran.stderr
    assert (ran.json["method"], ran.json["stopped_by"], ran.json["triangles"]) == (
        "certified",
        "triangles",
        896,
    )
    assert ran.json["details"]["shape_bound_m"] <= 0.05
    ran = scanloom("simplify", clean, light, "--triangles", 5, "--max-shape", 0.05, "--json")
    assert (ran.json["stopped_by"], ran.json["details"]["proven"]) == ("bounds", True)
    assert ran.json["triangles"] > 5


def test_bounds_per_triangle_are_written_with_the_mesh(scanloom: Run, ball: Path, tmp_path: Path) -> None:
    import trimesh

    clean, light, again = (tmp_path / f"{name}.ply" for name in ("clean", "light", "again"))
    scanloom("clean", ball, clean)
    bounds = ("--max-shape", 0.05, "--max-color", 20)
    ran = scanloom(
        "simplify",
        clean,
        light,
        *bounds,
        "--set",
        "simplify.certified.tight_bounds=true",
        "--save-bounds",
        light,
        "--json",
    )
    assert ran.exit_code == 0, ran.stderr
    plain = tmp_path / "plain.ply"
    scanloom("simplify", clean, plain, *bounds)
    np.testing.assert_array_equal(read_mesh(light).vertices, read_mesh(plain).vertices)
    face = trimesh.load(light).metadata["_ply_raw"]["face"]["data"]
    assert face["shape_bound"].max() <= ran.json["details"]["shape_bound_m"] <= 0.05
    assert face["color_bound"].max() <= ran.json["details"]["color_bound_levels"] <= 20
    assert len(np.unique(face["shape_bound"])) > 10

    ran = scanloom("mesh", "certify", light, clean, "--save-bounds", again)
    assert ran.exit_code == 0, ran.stderr
    assert "bounds of" in ran.stderr
    certified = trimesh.load(again).metadata["_ply_raw"]["face"]["data"]
    assert certified["shape_bound"].shape == face["shape_bound"].shape
    np.testing.assert_array_equal(read_mesh(again).triangles, read_mesh(light).triangles)


def test_patches_are_listed_and_coloured(scanloom: Run, ball: Path, tmp_path: Path) -> None:
    clean, light, colored = (tmp_path / name for name in ("clean.ply", "light.ply", "patches.ply"))
    scanloom("clean", ball, clean)
    bounds = ("--max-shape", 0.05)
    metrics = scanloom("simplify", clean, light, "--method", "planar", *bounds, "--json").json
    assert metrics["method"] == "planar"
    assert metrics["details"]["shape_bound_m"] <= 0.05
    assert len(read_mesh(light).triangles) == metrics["triangles"] < 1280
    # The patches belong to the bound with the fewest triangles.
    assert metrics["details"]["patch_shape_m"] <= metrics["details"]["max_shape_m"] == 0.05
    bounds = ("--max-shape", metrics["details"]["patch_shape_m"])
    ran = scanloom("mesh", "patches", clean, colored, *bounds)
    assert ran.exit_code == 0, ran.stderr
    assert f"{metrics['details']['patches']:,} patches, " in ran.stdout
    assert "largest patches" in ran.stdout
    result = scanloom("mesh", "patches", clean, colored, *bounds, "--json").json
    for name in ("patches", "area_m2", "largest_patches"):
        assert result[name] == metrics["details"][name]
    written = read_mesh(colored)
    assert written.colors is not None
    assert len(written.triangles) == 1280
    assert len(np.unique(written.colors, axis=0)) <= result["patches"]


def test_simplify_reports_bounds_that_cannot_be_proven(scanloom: Run, tmp_path: Path) -> None:
    # A black and a white sheet coincide, so the colour of the nearest point is ambiguous.
    source = tmp_path / "sheets.ply"
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]] * 2, float)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.int32)
    write_ply(source, Mesh(corners, triangles, np.repeat([[0] * 3, [255] * 3], 4, axis=0).astype(np.uint8)))
    light = tmp_path / "light.ply"
    ran = scanloom("simplify", source, light, "--max-color", 20)
    assert ran.exit_code == 1
    assert light.exists()
    assert f"scanloom: {source}: the requested bounds are not proven; " in ran.stderr
    assert "Not proven: the requested bounds, at 4 triangles of the result and 4 of" in ran.stdout


def test_simplify_warns_about_an_unreachable_triangle_count(
    scanloom: Run, ball: Path, tmp_path: Path
) -> None:
    light = tmp_path / "light.ply"
    ran = scanloom("simplify", ball, light, "--triangles", 1)
    assert f"warning: {ball}: 100% of the remaining edges belong to holes" in ran.stderr
    assert "diagnostics" not in ran.stdout
    (warning,) = scanloom("simplify", ball, light, "--triangles", 1, "--json").warnings
    # JSON names parameters as in a configuration file, stderr names options as the user types them.
    typed = re.sub(r"\b(clean\.\w+)", r"--set \1", warning)
    assert "warning: " + typed in ran.stderr
    assert "warning" not in scanloom("simplify", ball, light, "--ratio", 0.5).stderr


def test_a_collapse_record_replays_to_any_triangle_count(scanloom: Run, ball: Path, tmp_path: Path) -> None:
    clean, light, half = (tmp_path / f"{name}.ply" for name in ("clean", "light", "half"))
    record = tmp_path / "new" / "light.npz"
    scanloom("clean", ball, clean)
    regions = ("--region", "box -1 -1 0.9 1 1 1 lock", "--region", "sphere 1 0 0 0.5 50")
    ran = scanloom("simplify", clean, light, "--triangles", 200, *regions, "--save-record", record, "--json")
    assert ran.exit_code == 0, ran.stderr
    assert (ran.json["method"], ran.json["triangles"]) == ("quadric", 200)
    before, after = read_mesh(clean), read_mesh(light)
    locked = before.vertices[before.vertices[:, 2] >= 0.9]
    assert len(locked) > 10
    assert {tuple(v) for v in locked.tolist()} <= {tuple(v) for v in after.vertices.tolist()}
    right, left = (after.vertices[:, 0] * side > 0.8 for side in (1, -1))
    assert right.sum() > left.sum()

    ran = scanloom("mesh", "replay", record, half, "--ratio", 0.5, "--json")
    assert ran.exit_code == 0, ran.stderr
    assert ran.json["triangles"] == len(read_mesh(half).triangles) == 640
    scanloom("mesh", "replay", record, half, "--set", "replay.fit=true")
    assert half.read_bytes() == light.read_bytes()


def test_a_collapse_record_replays_a_bounded_simplification(
    scanloom: Run, ball: Path, tmp_path: Path
) -> None:
    clean, light, again = (tmp_path / f"{name}.ply" for name in ("clean", "light", "again"))
    record = tmp_path / "light.npz"
    scanloom("clean", ball, clean)
    ran = scanloom("simplify", clean, light, "--max-shape", 0.01, "--save-record", record)
    assert ran.exit_code == 0, ran.stderr
    assert scanloom("mesh", "replay", record, again).exit_code == 0
    assert again.read_bytes() == light.read_bytes()


def test_keep_on_interrupt_writes_the_mesh_simplified_so_far(
    scanloom: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    n = 400
    y, x = np.mgrid[0 : n + 1, 0 : n + 1] / n
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    triangles = np.stack([a, a + 1, a + n + 2, a, a + n + 2, a + n + 1], 1).reshape(-1, 3)
    hills = np.stack([x, y, 0.1 * np.sin(7 * x) * np.cos(5 * y)], -1).reshape(-1, 3)
    source, target = tmp_path / "hills.ply", tmp_path / "light.ply"
    write_ply(source, Mesh(hills, triangles.astype(np.int32)))

    @contextmanager
    def interrupt_at_progress(*_: object) -> Iterator[Progress]:
        yield lambda *_: signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("scanloom.cli.output.Output.progress", interrupt_at_progress)
    words = ("simplify", source, target, "--ratio", 0.01)
    assert scanloom(*words).exit_code == 130
    assert not target.exists()
    ran = scanloom(*words, "--keep-on-interrupt", "--json")
    assert ran.exit_code == 0
    assert ran.json["stopped_by"] == "request"
    assert 0.01 * len(triangles) < len(read_mesh(target).triangles) < len(triangles)


def test_clean_can_replace_its_input_file(scanloom: Run, ball: Path) -> None:
    assert scanloom("clean", ball, ball).exit_code == 0
    assert len(read_mesh(ball).triangles) == 1280
    assert [path.name for path in ball.parent.iterdir()] == ["ball.ply"]


def test_the_distance_of_a_mesh_to_itself_is_zero(scanloom: Run, ball: Path) -> None:
    metrics = scanloom("compare", ball, ball, "--set", "compare.samples=1000", "--json").json
    assert metrics["distance"]["symmetric"]["maximum_m"] == pytest.approx(0, abs=1e-6)
    text = scanloom("compare", ball, ball, "--set", "compare.samples=1000").stdout
    assert " mm  " in text
    assert "equal" in text


@pytest.mark.slow
def test_compare_is_repeatable_for_a_seed(scanloom: Run, ball: Path, tmp_path: Path) -> None:
    light = tmp_path / "light.ply"
    scanloom("clean", ball, light)
    words = ("compare", ball, light, "--set", "compare.samples=1000", "--json")
    one, two = ("--set", "compare.seed=3"), ("--set", "compare.seed=4")
    assert scanloom(*words, *one).stdout == scanloom(*words, *one).stdout
    assert scanloom(*words, *one).stdout != scanloom(*words, *two).stdout


def test_render_draws_the_mesh(scanloom: Run, ball: Path, tmp_path: Path) -> None:
    target = tmp_path / "ball.png"
    scanloom("clean", ball, ball)
    ran = scanloom("render", ball, target, "--width", 120, "--json")
    assert ran.exit_code == 0, ran.stderr
    picture = cv2.imread(str(target))
    assert picture.shape[1] == 120
    assert np.ptp(picture.reshape(-1, 3), axis=0).min() > 50


@pytest.mark.parametrize(
    ("words", "exit_code", "sentence"),
    [
        (("clean", "missing.ply", "out.ply"), 3, "missing.ply: there is no such file."),
        (("clean", ".", "out.ply"), 3, "this is a folder"),
        (("clean", "ball.ply", "out.xyz"), 2, "unknown file extension .xyz"),
        (("render", "ball.ply", "out.gif"), 2, "unknown file extension .gif"),
        (("clean", "ball.ply", "ball.ply/out.ply"), 3, "ball.ply"),
        (("simplify", "ball.ply", "out.ply", "--max-shape", "-1"), 2, "--max-shape is -1 m"),
        (("simplify", "ball.ply", "out.ply", "--ratio", "2"), 2, "--ratio is 2"),
        (("simplify", "ball.ply", "out.ply", "--triangles", "few"), 2, "--triangles"),
        (("simplify", "ball.ply", "out.ply", "--speed", "9"), 2, "--speed"),
        (("simplify", "ball.ply"), 2, "OUT"),
        (
            ("simplify", "ball.ply", "out.ply", "--method", "magic"),
            2,
            "--method is 'magic'; it must be one of",
        ),
        (
            ("simplify", "ball.ply", "out.ply", "--region", "cube 0 0 0"),
            2,
            "starts with neither sphere nor box",
        ),
        (("simplify", "ball.ply", "out.ply", "--save-record", "r.txt"), 2, "use .npz"),
        (
            (
                "simplify",
                "ball.ply",
                "out.ply",
                "--ratio",
                "0.5",
                "--set",
                "simplify.certified.tight_bounds=true",
            ),
            2,
            "needs max_shape or max_co",
        ),
        (
            (
                "simplify",
                "ball.ply",
                "out.ply",
                "--method",
                "jia01",
                "--set",
                "simplify.planar.crease_angle=30",
            ),
            2,
            "--set simplify.planar.crease_angle is not supported by method jia01; leave one of them out.",
        ),
        (
            ("simplify", "ball.ply", "out.ply", "--ratio", "0.5", "--save-bounds", "b.ply"),
            2,
            "give --max-shape",
        ),
        (("simplify", "ball.ply", "out.ply", "--max-shape", "1", "--save-bounds", "b.npz"), 2, "use .ply"),
        (("mesh", "certify", "ball.ply", "missing.ply"), 3, "missing.ply: there is no such file."),
        (
            ("mesh", "certify", "ball.ply", "ball.ply", "--set", "certify.effort=-1"),
            2,
            "--set certify.effort is -1",
        ),
        (("mesh", "replay", "ball.ply", "out.ply"), 3, "ball.ply: is damaged, or not a collapse record."),
        (("mesh", "replay", "missing.npz", "out.ply"), 3, "missing.npz: there is no such file."),
        (
            ("mesh", "replay", "ball.ply", "out.ply", "--ratio", "0.5", "--set", "replay.collapses=3"),
            2,
            "give one of them",
        ),
        (("compare", "ball.ply", "ball.ply", "--set", "compare.samples=0"), 2, "--set compare.samples is 0"),
        (("knit",), 2, "knit"),
    ],
)
def test_bad_input_is_one_error(
    scanloom: Run,
    ball: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    exit_code: int,
    sentence: str,
) -> None:
    monkeypatch.chdir(ball.parent)
    ran = scanloom(*words)
    assert ran.exit_code == exit_code
    assert sentence in ran.stderr
    assert ran.stderr.count("\n") == 1
    assert "Traceback" not in ran.stderr
    assert ran.stdout == ""
    assert not Path("out.ply").exists()


def test_a_truncated_mesh_is_bad_input_and_nothing_is_written(
    scanloom: Run, ball: Path, tmp_path: Path
) -> None:
    cut, target = tmp_path / "cut.ply", tmp_path / "out.ply"
    cut.write_bytes(ball.read_bytes()[:-50])
    ran = scanloom("clean", cut, target, "--json")
    assert ran.exit_code == 3
    assert "cut.ply" in ran.json["error"]
    assert ran.json["exit_code"] == 3
    assert not target.exists()


def test_simplify_splits_a_non_manifold_mesh_with_a_warning(scanloom: Run, tmp_path: Path) -> None:
    fan = tmp_path / "fan.ply"
    vertices = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, -1, 0]], float)
    write_ply(fan, Mesh(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], np.int32)))
    ran = scanloom("simplify", fan, tmp_path / "light.ply")
    assert ran.exit_code == 0
    assert ran.stderr.count(f"warning: {fan}: the surface is not a manifold: it was split into sheets") == 1
    assert "run clean first" in ran.stderr
    assert scanloom("simplify", fan, tmp_path / "light.ply", "--strict").exit_code == 1


def test_debug_adds_the_traceback(scanloom: Run) -> None:
    ran = scanloom("clean", "missing.ply", "out.ply", "--debug")
    assert ran.exit_code == 3
    assert "Traceback" in ran.stderr


def test_an_unexpected_exception_is_one_sentence(
    scanloom: Run, ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise KeyError("oops")

    monkeypatch.setattr("scanloom.stages.clean", fail)
    ran = scanloom("clean", ball, tmp_path / "out.ply", "--json")
    assert ran.exit_code == 1
    assert "bug in scanloom" in json.loads(ran.stdout)["error"]
    assert "Traceback" not in ran.stderr


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".glb"])
def test_an_output_replaces_the_target_of_a_symbolic_link(
    scanloom: Run, ball: Path, tmp_path: Path, suffix: str
) -> None:
    there = tmp_path / "there"
    there.mkdir()
    file, link = there / f"real{suffix}", tmp_path / f"link{suffix}"
    file.write_text("old")
    file.chmod(0o640)
    link.symlink_to(file)
    assert scanloom("clean", ball, link).exit_code == 0
    assert link.is_symlink()
    assert file.stat().st_mode & 0o777 == 0o640
    assert len(read_mesh(file).triangles) == 1280
    assert {path.name for path in tmp_path.iterdir()} == {"ball.ply", "there", link.name}


def test_images_and_materials_are_written_next_to_the_target_of_a_link(scanloom: Run, tmp_path: Path) -> None:
    (tmp_path / "wood.png").write_bytes(cv2.imencode(".png", np.full((4, 4, 3), 90, np.uint8))[1].tobytes())
    (tmp_path / "model.mtl").write_text("newmtl wood\nmap_Kd wood.png\n")
    model = tmp_path / "model.obj"
    model.write_text(
        "mtllib model.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\nusemtl wood\n"
        "f 1/1 2/2 3/3\nf 2/2 4/4 3/3\n"
    )
    there, link = tmp_path / "there", tmp_path / "link.obj"
    there.mkdir()
    link.symlink_to(there / "real.obj")
    assert scanloom("simplify", model, link, "--ratio", 1, "--method", "seams").exit_code == 0
    written = read_mesh(there / "real.obj")
    assert written.texture is not None
    assert written.texture.images
    assert sorted(path.name for path in tmp_path.glob("link*")) == ["link.obj"]


@pytest.mark.parametrize(
    ("words", "deviation"),
    [
        (
            ("--ratio", 0.5),
            r"deviation +up to 0\.\d+ m, .* \(measured at 100,000 points and all vertices\)",
        ),
        (("--max-shape", 0.01), r"Proven: no point is more than 0\.01 m"),
        (("--method", "planar"), r"deviation +at most 0\.\d+ m.* \(proven at every point\)"),
    ],
)
def test_simplify_prints_count_size_texture_and_deviation(
    scanloom: Run, ball: Path, tmp_path: Path, words: tuple[object, ...], deviation: str
) -> None:
    light = tmp_path / "light.ply"
    ran = scanloom("simplify", ball, light, *words, "--quiet")
    assert ran.exit_code == 0, ran.stderr
    rows = dict(re.split(r"\s{2,}", line, maxsplit=1) for line in ran.stdout.splitlines() if "  " in line)
    assert set(rows) - {"deviation"} == {"output", "triangles", "size", "texture", "stopped by"}
    triangles = [len(read_mesh(one).triangles) for one in (ball, light)]
    assert rows["triangles"].startswith(f"{triangles[0]:,} → {triangles[1]:,} (")
    assert rows["size"].startswith(
        f"{format_size(ball.stat().st_size)} → {format_size(light.stat().st_size)} ("
    )
    assert re.search(f"^{deviation}", ran.stdout, re.MULTILINE)
    assert "slack" not in ran.stdout
    result = scanloom("simplify", ball, light, *words, "--json").json
    assert {"collapses", "details", "refused_edges"} <= set(result)
