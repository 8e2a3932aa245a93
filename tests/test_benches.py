"""Meshes, comparisons and summaries of the benches; measured values are not tested."""

import dataclasses
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import topology

ROOT = Path(__file__).resolve().parents[1]
MAP = np.arange(8 * 16 * 3, dtype=np.uint8).reshape(8, 16, 3) % 200
NO_TRIANGLES = np.zeros((0, 3), np.int32)


@pytest.fixture(autouse=True)
def _add_benches_to_path(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(ROOT / "benches"))


@pytest.fixture
def meshes() -> ModuleType:
    import meshes

    return meshes


@pytest.fixture
def bench() -> ModuleType:
    import simplify

    return simplify


@pytest.fixture
def speed() -> ModuleType:
    import simplify_speed

    return simplify_speed


@pytest.fixture
def at_a_bound() -> ModuleType:
    import equal_deviation

    return equal_deviation


@pytest.fixture
def normal_mesh() -> ModuleType:
    import normal_mesh

    return normal_mesh


@pytest.fixture
def rates() -> ModuleType:
    import rate_distortion

    return rate_distortion


@pytest.fixture
def results() -> ModuleType:
    from peers import results

    return results


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_the_globe_is_a_closed_unit_sphere_facing_outward(meshes: ModuleType, steps: int):
    globe = meshes.make_globe(steps, MAP)

    assert len(globe.triangles) == 8 * steps**2
    shape = topology(globe)
    assert shape.is_closed
    assert shape.is_manifold
    assert shape.is_oriented
    assert shape.euler == 2
    np.testing.assert_allclose(np.linalg.norm(globe.vertices, axis=1), 1)
    a, b, c = globe.vertices[globe.triangles].swapaxes(0, 1)
    assert (np.cross(b - a, c - a) * a).sum(axis=1).min() > 0


def test_the_globe_map_wraps_at_the_date_line_and_ends_at_the_poles(meshes: ModuleType):
    globe = meshes.make_globe(2, MAP)

    def at(*direction: float) -> Any:
        return globe.colors[(globe.vertices @ direction).argmax()].astype(float)

    middle = slice(3, 5)  # the equator is between rows 3 and 4
    np.testing.assert_allclose(at(1, 0, 0), MAP[middle, 7:9].mean(axis=(0, 1)), atol=0.51)
    np.testing.assert_allclose(at(-1, 0, 0), MAP[middle][:, [0, -1]].mean(axis=(0, 1)), atol=0.51)
    np.testing.assert_allclose(at(0, 1, 0), MAP[middle, 11:13].mean(axis=(0, 1)), atol=0.51)
    np.testing.assert_allclose(at(0, 0, 1), MAP[0, 7:9].mean(axis=0), atol=0.51)
    np.testing.assert_allclose(at(0, 0, -1), MAP[-1, 7:9].mean(axis=0), atol=0.51)


def test_flat_colours_are_sea_land_and_ice():
    import jia_table

    image = np.empty((64, 90, 3), np.uint8)
    image[:, :30], image[:, 30:60], image[:, 60:] = (10, 30, 80), (120, 110, 60), (230, 235, 240)

    flat = jia_table.classify_colors(image)

    for column, expected in ((15, jia_table.SEA), (45, jia_table.LAND), (75, jia_table.ICE)):
        assert (flat[:, column] == expected).all()


@pytest.mark.parametrize("name", ["scanloom", "Open3D legacy", "Open3D tensor"])
def test_a_tool_s_result_is_a_mesh_of_the_wanted_size(meshes: ModuleType, name: str):
    from peers.tools import TOOLS

    globe = meshes.make_globe(12, MAP)
    (tool,) = [tool for tool in TOOLS if tool.name == name]

    call, unpacked = tool.prepare(globe, 400, **next(iter(tool.settings.values())))
    light = unpacked(call())

    assert 380 <= len(light.triangles) <= 400
    assert topology(light).is_closed
    assert (light.colors is not None) == tool.keeps_color


def test_turned_triangles_and_small_angles_are_counted(meshes: ModuleType, bench: ModuleType):
    globe = meshes.make_globe(4, MAP)
    turned = globe.triangles.copy()
    turned[[3, 50]] = turned[[3, 50], ::-1]

    assert bench.count_flipped(globe, globe) == 0
    assert bench.count_flipped(globe, globe.with_(triangles=turned)) == 2

    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], float)
    pair = Mesh(corners, np.array([[0, 1, 2], [0, 1, 3]], np.int32))
    np.testing.assert_allclose(bench.compute_min_angles(pair), [45, 0])


@pytest.fixture
def row(results: ModuleType):
    base = results.SimplifierResult(
        **{field.name: 0 for field in dataclasses.fields(results.SimplifierResult)}
        | {"mesh": "globe", "ratio": 0.1, "triangles": 1000, "rms": 1.0, "color": 5.0, "setting": "default"}
        | {"seconds": 1.0, "tool": "scanloom", "topology": topology(Mesh(np.zeros((0, 3)), NO_TRIANGLES))}
    )

    def changed(**changes: Any) -> Any:
        return dataclasses.replace(base, **changes)

    return changed


def test_a_setting_beats_another_only_in_both_errors_and_on_no_more_triangles(results: ModuleType, row: Any):
    assert results.is_better(row(rms=0.9, color=4.9), row())
    assert not results.is_better(row(rms=0.9, color=5.0), row())
    assert not results.is_better(row(rms=1.0, color=4.9), row())
    assert not results.is_better(row(rms=0.9, color=4.9, triangles=1011), row())
    assert not results.is_better(row(rms=0.9, color=4.9), row(color=None))

    own = [row(rms=2.0), row(setting="light", rms=0.9, color=4.0)]
    peers = [
        row(tool="VTK", setting="weight 1"),
        row(tool="VTK", setting="weight 2", color=3.0),
        row(tool="Open3D tensor", setting="", rms=0.8, color=None),
        row(tool="CGAL Lindstrom–Turk", setting="", rms=0.5, color=None),
    ]
    text = "\n".join(results.compare_with_peers([*own, *peers]))

    assert "VTK: 1 of 2 beaten (weight 1 ← light; weight 2 ← none)" in text
    assert "default is 2.50 times that of Open3D tensor, the best quadric tool" in text
    assert "default is 4.00 times that of CGAL Lindstrom–Turk, the best tool" in text


def test_the_summary_uses_best_results_and_skips_meshes_without_colours(results: ModuleType, row: Any):
    # Two triangles with the same direction along their common edge.
    broken = topology(Mesh(np.eye(4, 3), np.array([[0, 1, 2], [0, 1, 3], [1, 0, 2]], np.int32)))
    rows = [
        row(rms=2e-5, color=5.0, seconds=2.0),
        row(setting="light", rms=3e-5, color=3.0, seconds=1.0),
        row(tool="VTK", setting="weight 1", rms=5e-5, color=2.5, seconds=3.0, topology=broken),
        row(tool="VTK", setting="weight 2", rms=9e-5, color=2.0, seconds=9.0),
        row(tool="CGAL Lindstrom–Turk", setting="", rms=1e-5, color=None, seconds=10.0),
        row(mesh="horse", setting="", color=None),
    ]

    assert list(results.make_summary_table(rows)) == [
        "|  | globe 10% | non-manifold edges | CPU time |",
        "|---|---:|---:|---:|",
        "| scanloom | 2.0 / 5.0 | 0 | 1 |",
        "| scanloom, best of 2 weights | 3.0 / 3.0 | 0 | 0.5 |",
        "| CGAL Lindstrom–Turk | 1.0 / – | 0 | 5 |",
        f"| VTK, best of 2 weights | 5.0 / 2.5 | {broken.nonmanifold_edges} | 1.5 |",
    ]
    assert broken.nonmanifold_edges == 1


def test_shuffled_hills_are_the_same_hills_in_another_order(speed: ModuleType):
    mesh, shuffled = speed.make_hills(200), speed.make_shuffled_hills(200)

    def parts(mesh: Mesh) -> set[Any]:
        corners = np.concatenate([mesh.vertices, mesh.colors], axis=1)[mesh.triangles]
        # Rotate corners so that the smallest comes first; the orientation is unchanged.
        first = [min(range(3), key=lambda i: tuple(t[i])) for t in corners]
        return {np.roll(t, -i, axis=0).tobytes() for t, i in zip(corners, first, strict=True)}

    assert parts(shuffled) == parts(mesh)
    assert (shuffled.triangles != mesh.triangles).any()


def test_a_result_that_depends_on_the_number_of_threads_is_an_error(
    speed: ModuleType, monkeypatch: pytest.MonkeyPatch
):
    mesh = speed.make_hills(200)
    same = speed.compute_digest(speed.MODES["count"](mesh, 1))
    other = speed.compute_digest(speed.MODES["count"](mesh.with_(colors=mesh.colors[::-1].copy()), 1))
    runs = {1: {"digest": same, "seconds": 2.0, "elapsed": 3.0}}
    monkeypatch.setattr(speed, "measure_in_subprocess", lambda *run: runs[run[-1]])

    runs[2] = runs[1] | {"elapsed": 1.5}
    one, two = speed.measure_thread_counts("count", "hills", 200, 2)
    assert one["elapsed"] / two["elapsed"] == 2
    runs[2] = runs[1] | {"digest": other}
    with pytest.raises(SystemExit, match="differ"):
        list(speed.measure_thread_counts("count", "hills", 200, 2))


def test_growth_is_relative_to_n_log_n(speed: ModuleType):
    ratios = speed.compute_growth({10_000: 40.0, 100: 10.0, 1_000_000: 30.0})

    assert ratios == pytest.approx({100: 1, 10_000: 2, 1_000_000: 1})


def test_our_bound_is_the_deviation_of_the_peer(
    meshes: ModuleType, at_a_bound: ModuleType, monkeypatch: pytest.MonkeyPatch
):
    from scanloom.stages.simplification.simplify import simplify

    globe = meshes.make_globe(12, MAP)
    light = simplify(globe, ratio=0.2).mesh
    one = SimpleNamespace(name="one")
    peers = [(one, "weight 1", {}, light), (one, "weight 0", {}, light.with_(colors=None))]
    monkeypatch.setattr(at_a_bound, "run_tools", lambda *_: peers)
    asked = []

    def spy_on_call(*args: Any, **changes: Any) -> Any:
        asked.append((changes["max_shape"], changes["max_color"]))
        return simplify(*args, **changes)

    monkeypatch.setattr(at_a_bound, "simplify", spy_on_call)
    rows = list(at_a_bound.compare_at_deviation(globe, "globe", 0.2, [], 1000))

    distance, levels = at_a_bound.find_two_sided_maximum(globe, light, 1000)
    assert asked == [(distance, None), (distance, levels), (distance, None)]
    assert rows[0][1] == rows[2][1]
    assert "| one weight 1 |" in rows[0][0]
    assert all(row.count("|") == at_a_bound.HEAD.splitlines()[0].count("|") for row, _ in rows)


def test_measuring_more_than_the_proven_bound_is_an_error(meshes: ModuleType, at_a_bound: ModuleType):
    from scanloom.stages.simplification.simplify import simplify

    globe = meshes.make_globe(12, MAP)
    ours = simplify(globe, max_shape=0.02, max_color=40)

    assert 0 < at_a_bound.compute_proof_ratio(globe, ours, 1000) <= 1
    for less in ({"shape_bound_m": 1e-4}, {"color_bound_levels": 1.0}):
        wrong = dataclasses.replace(ours, details=dataclasses.replace(ours.details, **less))
        with pytest.raises(SystemExit, match="proof is wrong"):
            at_a_bound.compute_proof_ratio(globe, wrong, 1000)


def test_the_near_cube_is_a_closed_unit_cube_facing_outward(normal_mesh: ModuleType):
    cube = normal_mesh.make_near_cube()

    assert len(cube.triangles) == 396
    shape = topology(cube)
    assert shape.is_closed
    assert shape.is_manifold
    assert shape.is_oriented
    assert shape.euler == 2
    a, b, c = cube.vertices[cube.triangles].swapaxes(0, 1)
    assert (np.cross(a, b) * c).sum() / 6 == pytest.approx(1)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(6)


def test_triangles_rotated_by_more_than_90_degrees_are_flipped(normal_mesh: ModuleType):
    cube = normal_mesh.make_near_cube()
    other = cube.triangles.copy()
    other[[7, 300]] = other[[7, 300], ::-1]

    assert normal_mesh.count_flipped(cube, cube) == (0, 0)
    assert normal_mesh.count_flipped(cube, cube.with_(triangles=other)) == (2, 2)
    assert normal_mesh.count_flipped(cube.with_(triangles=other), cube) == (2, 0)


def test_a_file_is_optimal_if_none_is_smaller_and_closer(rates: ModuleType):
    small, middle, large = (
        rates.EncodedMesh(*values, "") for values in ((100, 4e-3), (200, 2e-3), (400, 1e-3))
    )
    worse = [
        rates.EncodedMesh(150, 4e-3, ""),
        rates.EncodedMesh(200, 3e-3, ""),
        rates.EncodedMesh(500, 1e-3, ""),
    ]

    assert rates.select_pareto_front([large, *worse, small, middle]) == [small, middle, large]


def test_our_size_is_an_existing_file_and_the_peer_size_is_interpolated(rates: ModuleType):
    files = [rates.EncodedMesh(*values, "") for values in ((100, 4e-3), (200, 2e-3), (800, 1e-3))]

    assert rates.find_smallest(files, 2.5e-3) is files[1]
    assert rates.find_smallest(files, 2e-3) is files[1]
    assert rates.find_smallest(files, 0.9e-3) is None
    assert rates.interpolate_size(files, 4e-3) == pytest.approx(100)
    assert rates.interpolate_size(files, 2e-3) == pytest.approx(200)
    # Interpolation is halfway in logarithms.
    assert rates.interpolate_size(files, 2e-3 / 2**0.5) == pytest.approx(400)
    assert rates.interpolate_size(files, 4.1e-3) is None
    assert rates.interpolate_size(files, 0.9e-3) is None


def test_a_file_s_distance_is_the_larger_of_both_directions(normal_mesh: ModuleType, rates: ModuleType):
    cube = normal_mesh.make_near_cube()
    shifted = cube.with_(vertices=cube.vertices + np.array((0, 0, 0.01)))
    half = cube.with_(triangles=cube.triangles[:198])
    original = rates.ReferenceMesh(cube, 20_000)

    # Two of six sides move off the surface, four along it.
    assert original.file(1, shifted, "").rms == pytest.approx(0.01 / 3, rel=0.05)
    assert original.file(1, cube, "").rms < 1e-9
    # All points of a part are on the whole, but the whole is far from the part.
    assert original.file(1, half, "").rms > 0.1
    assert rates.EncodedMesh(1, 1e-3, "").decibels == pytest.approx(60)


def test_draco_keeps_all_vertices_within_its_grid(normal_mesh: ModuleType):
    pytest.importorskip("DracoPy")
    from peers.draco import decode_draco, encode_draco

    cube = normal_mesh.make_near_cube()
    found = decode_draco(encode_draco(cube, 9))

    assert len(found.triangles) == len(cube.triangles)
    gaps = np.linalg.norm(found.vertices[:, None] - cube.vertices, axis=2)
    # Half a quantisation step along each axis.
    assert gaps.min(axis=1).max() <= 3**0.5 / 2 / (2**9 - 1) * (1 + 1e-6)
    assert len(encode_draco(cube, 12)) > len(encode_draco(cube, 9))


@pytest.fixture
def normal_mesh_rates() -> ModuleType:
    import normal_mesh_rates

    return normal_mesh_rates


def test_every_level_and_every_simplified_mesh_is_a_separate_file(
    normal_mesh: ModuleType,
    normal_mesh_rates: ModuleType,
    rates: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
):
    cube = normal_mesh.make_near_cube()
    setting = normal_mesh_rates.RemeshSettings(68, 2, (1e-3, 1e-4))
    monkeypatch.setattr(normal_mesh_rates, "LEVEL_SETTINGS", {"cube": (setting,)})
    monkeypatch.setattr(normal_mesh_rates, "NO_LEVEL_RATIOS", {"cube": (0.5,)})
    original = rates.ReferenceMesh(cube, 2000)

    coarse, fine = np.array_split(list(normal_mesh_rates.make_files_with_levels("cube", original)), 2)
    assert [file.made.split(", ")[1] for file in coarse] == [f"level {level} of 2" for level in range(3)]
    for files in (coarse, fine):
        assert np.diff([file.size for file in files]).min() > 0
    assert all(a.size < b.size for a, b in zip(coarse, fine, strict=True))

    whole = list(normal_mesh_rates.make_files_without_levels("cube", original))
    assert len(whole) == len(normal_mesh_rates.NO_LEVEL_TOLERANCES)
    for file, tolerance in zip(whole, normal_mesh_rates.NO_LEVEL_TOLERANCES, strict=True):
        assert "198 triangles" in file.made
        # The remeshed half cube equals the half cube, except for rounding along three axes.
        assert file.rms < 3**0.5 * tolerance
    assert np.diff([file.size for file in whole]).min() > 0


def test_a_ratio_above_1_misses_the_target(normal_mesh_rates: ModuleType, rates: ModuleType):
    file = rates.EncodedMesh(300, 1e-3, "")

    assert normal_mesh_rates.format_target_ratio(file, 200) == "1.50"
    assert normal_mesh_rates.format_target_ratio(file, None) == ""
    assert normal_mesh_rates.format_target_ratio(None, 200) == ""


SAMPLE = ROOT / "samples" / "rgbd"


@pytest.fixture
def registration() -> ModuleType:
    import registration

    return registration


@pytest.fixture
def reconstruction() -> ModuleType:
    import open3d_reconstruction

    return open3d_reconstruction


def compute_worst_pose_errors(poses: dict[int, Any], truth: list[Any]) -> tuple[float, float]:
    """Compute the largest position error in metres and angle in radians, in the first camera's frame."""
    from scanloom.stages.registration.motion import compute_rotation_angle

    first = invert_pose(truth[0].world_from_camera)
    off = [invert_pose(poses[i]) @ first @ frame.world_from_camera for i, frame in enumerate(truth)]
    return max(np.linalg.norm(one[:3, 3]) for one in off), max(compute_rotation_angle(one) for one in off)


@pytest.mark.slow
@pytest.mark.parametrize("fragment_frames", [12, 4])
def test_open3d_reconstruction_finds_the_poses_of_the_sample(
    registration: ModuleType, reconstruction: ModuleType, fragment_frames: int
):
    truth = registration.read_frames(SAMPLE)[::2]
    hidden = [registration.hide_pose(frame, depth_only=False) for frame in truth]

    poses = reconstruction.run_reconstruction_system(hidden, fragment_frames=fragment_frames)

    assert sorted(poses) == list(range(len(truth)))
    shift, turn = compute_worst_pose_errors(poses, truth)
    assert shift < 0.01
    assert turn < np.radians(0.5)


def test_a_scan_beyond_the_reconstruction_system_s_depth_fails(
    registration: ModuleType, reconstruction: ModuleType
):
    near = registration.read_frames(SAMPLE)[:2]
    far = [
        dataclasses.replace(frame, depth=np.full((240, 320), 3.5, np.float32), world_from_camera=None)
        for frame in near
    ]

    with pytest.raises(RuntimeError, match="no frame overlaps the next within 3 m"):
        reconstruction.run_reconstruction_system(far)


def test_outliers_do_not_affect_a_rigid_motion(reconstruction: ModuleType):
    rng = np.random.default_rng(3)
    a = rng.uniform(-1, 1, (30, 3))
    motion = np.eye(4)
    motion[:3, :3] = [[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]
    motion[:3, 3] = (0.1, -0.2, 0.3)
    b = a @ motion[:3, :3].T + motion[:3, 3]
    b[::3] += rng.uniform(0.5, 1, (10, 3))

    np.testing.assert_allclose(reconstruction.estimate_rigid_motion(a, b), motion, atol=1e-9)
    assert reconstruction.estimate_rigid_motion(a[:4], b[:4]) is None
    assert reconstruction.estimate_rigid_motion(a, rng.uniform(-1, 1, (30, 3))) is None
    half_a_turn = a * (-1, -1, 1)
    assert reconstruction.estimate_rigid_motion(a, half_a_turn) is None


def test_open3d_s_dense_slam_follows_the_sample(registration: ModuleType):
    from open3d_slam import run_dense_slam

    truth = registration.read_frames(SAMPLE)[:4]

    poses = run_dense_slam([registration.hide_pose(frame, depth_only=True) for frame in truth])

    shift, turn = compute_worst_pose_errors(poses, truth)
    assert shift < 0.01
    assert turn < np.radians(1)


def test_peers_get_every_nth_frame_without_pose_or_colour(
    registration: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    truth = registration.read_frames(SAMPLE)[::8]
    seen = []

    def spy_on_call(frames: Any) -> Any:
        seen.extend(frames)
        return [{i: frame.world_from_camera for i, frame in enumerate(truth[:2])}, {2: np.eye(4)}]

    monkeypatch.setitem(registration.TOOLS, "spy", spy_on_call)
    options = ["--every", "8", "--depth-only", "--only", "spy"]
    monkeypatch.setattr("sys.argv", ["registration.py", str(SAMPLE), *options])
    registration.main()

    assert [frame.name for frame in seen] == ["0000", "0008", "0016"]
    assert all(frame.color is None and frame.world_from_camera is None for frame in seen)
    cells = capsys.readouterr().out.splitlines()[-1].split(" | ")
    assert cells[1:5] == ["spy", "2 of 3", "2", "0.0"]


def test_a_failure_of_a_peer_is_a_row_with_the_reason(
    registration: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def failing(_: Any) -> Any:
        raise RuntimeError(
            "\x1b[1;31m[Open3D Error] (void a::b(int)) /c/d.cpp:7: Singular 6x6 system.\n\x1b[0;m"
        )

    monkeypatch.setitem(registration.TOOLS, "spy", failing)
    monkeypatch.setattr("sys.argv", ["registration.py", str(SAMPLE), "--every", "12", "--only", "spy"])
    registration.main()

    assert capsys.readouterr().out.splitlines()[-1] == "| rgbd | spy | failed: Singular 6x6 system. |"
