import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from partial_meshes import select_quarter

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.comparing.certify import CertifyParams, certify
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.raycasting import (
    ClosestPoints,
    RaycastingSurface,
    compute_bounding_box,
    compute_closest_weights,
    interpolate_values,
)
from scanloom.stages.surface.topology import compute_areas

pytestmark = pytest.mark.slow


def make_mesh(vertices, triangles, colors=None) -> Mesh:
    colors = None if colors is None else np.asarray(colors, np.uint8)
    return Mesh(np.asarray(vertices, float), np.asarray(triangles, np.int32), colors)


def sheet(n: int = 9, height: float = 0.0, color=None) -> Mesh:
    """Make the flat square [0, 1]² at z = height with n × n vertices."""
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])
    colors = None if color is None else np.tile(color, (n * n, 1))
    return make_mesh(np.stack([x.ravel(), y.ravel(), np.full(n * n, height)], axis=1), triangles, colors)


def join_meshes(*parts: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(p.vertices) for p in parts)])
    return make_mesh(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.triangles + start for p, start in zip(parts, starts, strict=False)]),
        None if parts[0].colors is None else np.concatenate([p.colors for p in parts]),
    )


# The square with one diagonal or the other: equal vertices, but a different surface everywhere else.
RISING, FALLING = [[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
WHITE = 255 * math.sqrt(3)


# Known answers.


def test_bounds_of_parallel_planes_equal_their_gap():
    result, original = sheet(4, 0.03), sheet(9)
    for tolerance in (0.05, 1e-3):
        found = certify(result, original, shape_tolerance=tolerance)
        for bounds, count in ((found.shape_bound, 18), (found.original_shape_bound, 128)):
            assert bounds.shape == (count,)
            assert (bounds >= 0.03).all()
            assert (bounds <= 0.03 * (1 + tolerance) + found.slack_m).all()
    assert found.shape_attained_m == pytest.approx(0.03, rel=1e-12)
    assert found.color_bound is None
    assert found.color_bound_levels is None


def test_the_bound_of_a_tent_is_its_height():
    tent = make_mesh([*SQUARE, [0.5, 0.5, 0.4]], [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    found = certify(sheet(6), tent)
    assert found.shape_attained_m == pytest.approx(0.4)
    assert (found.original_shape_bound >= 0.4).all()
    assert (found.original_shape_bound <= 0.4 * 1.05 + found.slack_m).all()
    # From below, the distance is the distance to a side: 0.4 · cos of its slope. The two-sided bound includes
    # the apex.
    one_way = certify(tent, sheet(6)).original_shape_bound
    slope = math.hypot(0.5, 0.4)
    assert 0.4 * 0.5 / slope < one_way.max() < 0.4 * 0.5 / slope * 1.06
    assert found.shape_bound.max() == found.shape_bound_m


@pytest.mark.parametrize("height", [0.01, 0.3, 1.0])
def test_the_middle_of_crossing_diagonals_is_bounded(height):
    vertices = SQUARE + np.outer([0, 1, 0, 1], [0, 0, height])
    found = certify(make_mesh(vertices, RISING), make_mesh(vertices, FALLING))
    # The middle of one diagonal against the plane z = height·(x + y) of the triangles of the other.
    expected = height / math.sqrt(1 + 2 * height**2)
    assert expected <= found.shape_bound_m <= 1.06 * expected
    assert expected / 1.06 <= found.shape_attained_m <= expected * (1 + 1e-9)


def test_colour_differs_most_in_the_middle_of_crossing_diagonals():
    colors = np.array([[0], [255], [0], [255]]) * [1, 1, 1]
    found = certify(make_mesh(SQUARE, RISING, colors), make_mesh(SQUARE, FALLING, colors))
    assert WHITE <= found.color_bound_levels <= 1.06 * WHITE
    assert found.color_attained_levels > 0.94 * WHITE
    assert found.shape_bound_m <= 2.1 * found.slack_m


def test_a_steeper_ramp_differs_most_at_its_end():
    flat = sheet(5, color=[10, 10, 10])
    ramp = sheet(9, 0.01, [10, 10, 10])
    rising = ramp.with_(colors=(10 + ramp.vertices[:, :1] * [200, 0, 0]).astype(np.uint8))
    found = certify(flat, rising)
    assert 200 <= found.color_bound_levels <= 201.5
    # For each triangle, the error at its own end of the ramp.
    ends = rising.colors[rising.triangles].max(axis=(1, 2)) - 10.0
    assert (found.original_color_bound >= ends).all()
    assert (found.original_color_bound <= 1.2 * ends + 6).all()


@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-3])
def test_between_two_sheets_both_colours_are_bounded(gap):
    layers = join_meshes(sheet(4, -gap, [0, 0, 0]), sheet(5, gap, [255, 255, 255]))
    found = certify(sheet(3, 0.0, [100, 100, 100]), layers)
    # The middle sheet has the same distance to both.
    assert found.color_bound == pytest.approx(155 * math.sqrt(3), abs=0.1)
    assert gap <= found.shape_bound_m <= 1.05 * gap + 2.1 * found.slack_m


def test_equal_meshes_differ_by_the_slack_only():
    rng = np.random.default_rng(1)
    one = sheet(12)
    one = one.with_(
        vertices=one.vertices + 0.01 * rng.normal(size=one.vertices.shape),
        colors=rng.integers(0, 256, one.vertices.shape).astype(np.uint8),
    )
    found = certify(one, one)
    assert found.shape_bound_m <= 2.1 * found.slack_m
    # Colours change by up to 441 levels along an edge of 1/12.
    assert found.color_bound_levels < 1.1


# Bounds compared with independent samples.


def find_closest_by_brute_force(points, target: Mesh):
    """Compute closest points by testing every triangle."""
    corners = target.vertices[target.triangles]
    best = np.full(len(points), np.inf)
    where, weights = np.zeros(len(points), int), np.zeros((len(points), 3))
    for t, triangle in enumerate(corners):
        w = compute_closest_weights(points, np.broadcast_to(triangle, (len(points), 3, 3)))
        d = np.linalg.norm(points - w @ triangle, axis=1)
        closer = d < best
        best[closer], where[closer], weights[closer] = d[closer], t, w[closer]
    return ClosestPoints(where, weights, best)


def find_closest_by_embree(points, target: Mesh):
    box = compute_bounding_box(target)
    box = np.stack([np.minimum(box[0], points.min(axis=0)), np.maximum(box[1], points.max(axis=0))])
    return RaycastingSurface(target, box).find_closest_points(points)


def sample_attack_points(mesh: Mesh, other: Mesh, count: int, rng) -> ClosestPoints:
    """Sample points of `mesh`.

    Interior, edges, corners, and projections of the other mesh's vertices and edges.
    """
    m, k = len(mesh.triangles), len(other.triangles)
    share = compute_areas(mesh.vertices, mesh.triangles)
    share = share / share.sum() if share.sum() > 0 else np.full(m, 1 / m)
    on_sides = np.zeros((2 * m, 3))
    side, along = rng.integers(0, 3, 2 * m), rng.random(2 * m)
    on_sides[np.arange(2 * m), side] = along
    on_sides[np.arange(2 * m), (side + 1) % 3] = 1 - along
    at = [
        (rng.choice(m, count, p=share), rng.dirichlet([1, 1, 1], count)),
        (np.arange(2 * m) % m, on_sides),
    ]
    fixed = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1 / 3] * 3, [0.999, 5e-4, 5e-4], [0.4995, 0.4995, 1e-3]]
    at += [(np.arange(m), np.tile(np.asarray(weights, float), (m, 1))) for weights in fixed]
    corners = other.vertices[other.triangles]
    start, end = (corners[np.arange(2 * k) % k, rng.integers(0, 3, 2 * k)] for _ in range(2))
    crossing = start + rng.random((2 * k, 1)) * (end - start)
    for points in (corners.reshape(-1, 3), crossing):
        found = find_closest_by_brute_force(points, mesh) if m < 200 else find_closest_by_embree(points, mesh)
        at.append((found.triangles, found.weights))
    return ClosestPoints(np.concatenate([t for t, _ in at]), np.concatenate([w for _, w in at]), np.zeros(0))


def assert_bounds_hold(result, original, found, count, rng, nearest):
    """Check that no bound is exceeded; return the largest distance and colour difference."""
    most = [0.0, 0.0]
    for mesh, other, shape, color in (
        (result, original, found.shape_bound, found.color_bound),
        (original, result, found.original_shape_bound, found.original_color_bound),
    ):
        at = sample_attack_points(mesh, other, count, rng)
        points = interpolate_values(mesh.vertices, mesh, at)
        hit = nearest(points, other)
        assert (hit.distances <= shape[at.triangles]).all()
        most[0] = max(most[0], hit.distances.max())
        if color is not None:
            difference = interpolate_values(mesh.colors, mesh, at) - interpolate_values(
                other.colors, other, hit
            )
            difference = np.linalg.norm(difference, axis=1)
            assert (difference <= color[at.triangles]).all()
            most[1] = max(most[1], difference.max())
            if mesh is original:
                assert (difference <= found.color_bound[hit.triangles]).all()
        if mesh is original:
            assert (hit.distances <= found.shape_bound[hit.triangles]).all()
    assert found.shape_attained_m <= found.shape_bound_m
    assert most[0] <= found.shape_bound_m
    if found.color_bound is not None:
        assert found.color_attained_levels <= found.color_bound_levels
        assert most[1] <= found.color_bound_levels
    return most


def make_soup(rng, count: int) -> Mesh:
    """Make random triangles: some share corners, some are flat or degenerate, some are duplicates."""
    vertices = rng.normal(size=(count + 2, 3)) * rng.choice([1.0, 0.1, 0.0], 3)
    triangles = rng.integers(0, len(vertices), (count, 3))
    return make_mesh(vertices, triangles, rng.integers(0, 256, (len(vertices), 3)))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 14), st.integers(1, 14), st.sampled_from([2, 16]))
def test_no_sample_of_random_triangles_exceeds_the_bounds(seed, a, b, effort):
    rng = np.random.default_rng(seed)
    result, original = make_soup(rng, a), make_soup(rng, b)
    assert_bounds_hold(
        result, original, certify(result, original, effort=effort), 300, rng, find_closest_by_brute_force
    )


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 0.3), st.floats(0, 0.05))
def test_no_sample_of_disturbed_surfaces_exceeds_the_tight_bounds(seed, across, along):
    rng = np.random.default_rng(seed)

    def disturbed(n):
        flat = sheet(n)
        offset = rng.normal(size=flat.vertices.shape) * [along, along, across]
        colors = rng.integers(0, 256, flat.vertices.shape).astype(np.uint8)
        return flat.with_(vertices=flat.vertices + offset, colors=colors)

    result, original = disturbed(3), disturbed(5)
    found = certify(result, original)
    assert_bounds_hold(result, original, found, 2000, rng, find_closest_by_brute_force)
    assert_bounds_hold(result, original, found, 2000, rng, find_closest_by_embree)
    assert found.shape_bound_m <= 1.06 * found.shape_attained_m + 10 * found.slack_m


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 2.0), st.floats(50, 440))
def test_certified_limits_hold(seed, max_shape, max_color):
    rng = np.random.default_rng(seed)
    result, original = make_soup(rng, 6), make_soup(rng, 6)
    found = certify(result, original, max_shape=max_shape, max_color=max_color)
    shape, color = assert_bounds_hold(result, original, found, 300, rng, find_closest_by_brute_force)
    if found.within_limits:
        assert shape <= max_shape
        assert color <= max_color
    full = certify(result, original)
    if full.shape_bound_m <= 0.9 * max_shape and full.color_bound_levels <= 0.9 * max_color:
        assert found.within_limits


@pytest.mark.parametrize(
    ("name", "ratio", "excess"),
    [
        ("cow.obj", 0.1, 1.1),
        ("stanford-bunny.obj", 0.1, 1.1),
        # Here Embree misses needles of the original.
        ("redkitchen_fused_vertexcolor.ply", 0.5, 1.1),
    ],
)
def test_a_million_samples_of_a_real_mesh_do_not_exceed_the_bounds(shared_data, name, ratio, excess):
    original = read_mesh(shared_data / "meshes" / name)
    original = clean(original if name == "cow.obj" else select_quarter(original)).mesh
    result = simplify(original, ratio=ratio).mesh
    found = certify(result, original)
    rng = np.random.default_rng(7)
    shape, color = assert_bounds_hold(result, original, found, 1_000_000, rng, find_closest_by_embree)
    assert found.shape_bound_m <= excess * shape
    if found.color_bound_levels is not None:
        assert found.color_bound_levels <= excess * color


def test_bounds_hold_if_the_search_misses_a_needle():
    # Two halves of a square joined by a needle that protrudes from their plane.
    height = 0.002
    left, right = [[0, 0, 0], [0, 1, 0], [-1, 0.5, 0]], [[0, 0, 0], [1, 0.5, 0], [0, 1, 0]]
    original = make_mesh([*left, *right, [height, 0.5, height]], [[0, 1, 2], [3, 4, 5], [3, 5, 6]])
    result = make_mesh([[0, 0, 0], [0, 1, 0], [height, 0.5, height]], [[0, 1, 2]])
    without = original.with_(triangles=original.triangles[:2])
    found = certify(result, original)
    at = sample_attack_points(result, without, 1000, np.random.default_rng(0))
    hit = find_closest_by_brute_force(interpolate_values(result.vertices, result, at), without)
    assert hit.distances.max() > 0.9 * height
    assert (hit.distances <= found.shape_bound[at.triangles]).all()


# Changes without effect, and changes with effect.


@pytest.fixture(scope="module")
def bumps() -> tuple[Mesh, Mesh]:
    """Make a bumpy coloured sheet and simplify it to a fifth of its triangles."""
    rng = np.random.default_rng(3)
    fine = sheet(24)
    z = 0.05 * np.sin(9 * fine.vertices[:, 0]) * np.cos(7 * fine.vertices[:, 1])
    vertices = fine.vertices + np.stack([0 * z, 0 * z, z], axis=1) + 0.002 * rng.normal(size=(len(z), 3))
    color = np.stack([2000 * z + 128, 255 * fine.vertices[:, 0], rng.integers(0, 60, len(z))], axis=1)
    original = fine.with_(vertices=vertices, colors=color.clip(0, 255).astype(np.uint8))
    return simplify(original, ratio=0.2).mesh, original


def list_bounds(found):
    return [found.shape_bound, found.color_bound, found.original_shape_bound, found.original_color_bound]


def test_results_do_not_depend_on_the_number_of_threads(bumps):
    one, two, three = (certify(*bumps, threads=n) for n in (1, 2, 3))
    for a, b, c in zip(list_bounds(one), list_bounds(two), list_bounds(three), strict=True):
        assert a.tobytes() == b.tobytes() == c.tobytes()
    assert one.to_dict() == two.to_dict() == three.to_dict()


def test_more_effort_never_increases_a_bound(bumps):
    before = certify(*bumps, effort=0, color_tolerance=0, color_floor=0, shape_tolerance=0)
    for effort in (1, 4, 16, 64):
        now = certify(*bumps, effort=effort, color_tolerance=0, color_floor=0, shape_tolerance=0)
        assert all((a <= b).all() for a, b in zip(list_bounds(now), list_bounds(before), strict=True))
        assert now.color_attained_levels >= before.color_attained_levels
        before = now
    assert now.pieces > 1000


def test_a_rigid_motion_hardly_changes_the_bounds(bumps):
    rotation = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    moved = [m.with_(vertices=m.vertices @ rotation.T + [3.0, -2.0, 1.0]) for m in bumps]
    here, there = certify(*bumps), certify(*moved)
    assert there.shape_bound_m == pytest.approx(here.shape_bound_m, rel=0.06)
    assert there.color_bound_levels == pytest.approx(here.color_bound_levels, rel=0.06)
    assert there.shape_attained_m <= here.shape_bound_m
    assert here.shape_attained_m <= there.shape_bound_m


def test_far_from_the_origin_the_slack_follows_single_precision(bumps):
    moved = [m.with_(vertices=m.vertices + np.array([5e5, 5e5, 0])) for m in bumps]
    assert certify(*moved).slack_m == pytest.approx(5e5 * 2**-21, rel=0.01)
    assert certify(*moved, slack=1e-7).slack_m == pytest.approx(5e5 * 2**-40, rel=0.01)


def test_bounds_of_single_triangles_are_tight(bumps):
    result, original = bumps
    found = certify(result, original)
    at = sample_attack_points(original, result, 400_000, np.random.default_rng(2))
    hit = find_closest_by_embree(interpolate_values(original.vertices, original, at), result)
    seen = np.zeros(len(original.triangles))
    np.maximum.at(seen, at.triangles, hit.distances)
    assert (found.original_shape_bound <= 1.3 * seen + 0.03 * found.shape_bound_m).all()


def test_limits_are_decided_where_the_bound_is_clear(bumps):
    full = certify(*bumps)
    shape, color = full.shape_bound_m, full.color_bound_levels
    assert certify(*bumps, max_shape=shape, max_color=color).within_limits
    assert not certify(*bumps, max_shape=0.9 * full.shape_attained_m).within_limits
    assert not certify(*bumps, max_color=0.9 * full.color_attained_levels).within_limits
    limited = certify(*bumps, max_shape=0.5 * shape)
    assert limited.color_bound is None
    # Triangles fail whose bound is above half, as far as both bounds are close.
    fails = limited.original_shape_bound > 0.5 * shape
    assert fails[full.original_shape_bound > 0.65 * shape].all()
    assert not fails[full.original_shape_bound <= 0.5 * shape].any()


# Input.


def test_an_empty_mesh_is_infinitely_far():
    nothing = make_mesh(np.zeros((0, 3)), np.zeros((0, 3)))
    found = certify(nothing, sheet(3))
    assert np.isinf(found.original_shape_bound).all()
    assert len(found.shape_bound) == 0
    assert json.loads(json.dumps(found.to_dict()))["shape_bound_m"] is None
    assert certify(nothing, nothing).shape_bound_m == 0


def test_degenerate_triangles_count_as_surface():
    point = make_mesh([[0.0, 0, 2], [0, 0, 2], [0, 0, 2]], [[0, 1, 2]], np.full((3, 3), 9))
    needle = make_mesh(
        [[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0]], [[0, 1, 2]], [[0, 0, 0], [200, 0, 0], [100, 0, 0]]
    )
    found = certify(point, needle)
    assert found.shape_bound_m == pytest.approx(math.sqrt(5), rel=0.06)
    assert found.color_bound_levels == pytest.approx(math.sqrt(191**2 + 81 + 81), rel=0.06)


def test_unusable_input_is_refused_in_one_sentence():
    broken = sheet(3)
    with pytest.raises(MeshError, match="triangle 0 uses vertices"):
        certify(broken.with_(triangles=np.array([[0, 1, 99]], np.int32)), broken)
    with pytest.raises(MeshError, match="not finite"):
        certify(broken, broken.with_(vertices=np.full((9, 3), np.nan)))
    with pytest.raises(MeshError, match="beyond"):
        certify(broken, broken.with_(vertices=np.full((9, 3), 1e70)))
    with pytest.raises(UsageError, match="max_color"):
        certify(broken, broken, max_color=3)
    with pytest.raises(UsageError, match="effort"):
        CertifyParams(effort=-1)


def test_progress_is_reported_and_can_stop_the_work():
    class EnoughError(Exception):
        pass

    def stop(done, total):
        assert 0 <= done <= total
        raise EnoughError

    def scattered(n):
        vertices = np.random.default_rng(n).normal(size=(3 * n, 3))
        return make_mesh(vertices, np.arange(3 * n).reshape(-1, 3))

    with pytest.raises(EnoughError):
        certify(scattered(2000), scattered(3000), progress=stop)


def test_limits_do_not_change_the_bounds(bumps):
    full = certify(*bumps)
    for limits in ({"max_shape": 0.1}, {"max_shape": 0.1, "max_color": 900}, {"max_color": 900}):
        limited = certify(*bumps, **limits)
        assert limited.within_limits
        assert limited.shape_bound_m <= full.shape_bound_m
        assert (limited.shape_bound <= full.shape_bound).all()
        if "max_color" in limits:
            assert limited.color_bound_levels <= full.color_bound_levels


def test_a_pure_decision_returns_the_limits_as_bounds(bumps):
    full = certify(*bumps)
    limit = 4 * full.shape_bound_m
    decided = certify(*bumps, max_shape=limit, check_only=True)
    assert decided.within_limits
    assert (decided.shape_bound == limit).all()
    assert decided.pieces < full.pieces
    with pytest.raises(UsageError, match="check_only"):
        certify(*bumps, check_only=True)


def test_a_refusal_states_no_bound(bumps):
    tight = certify(*bumps)
    refused = certify(*bumps, max_shape=0.5 * tight.shape_attained_m, check_only=True)
    assert refused.within_limits is False
    assert np.isinf(refused.shape_bound_m)
    assert refused.to_dict()["shape_bound_m"] is None
    assert refused.to_dict()["shape_attained_m"] > 0.5 * tight.shape_attained_m
    # A quantity that keeps its limit has a bound, whatever the other one does.
    limits = {"max_shape": 2 * tight.shape_bound_m, "max_color": 0.5 * tight.color_attained_levels}
    mixed = certify(*bumps, **limits, check_only=True)
    assert mixed.within_limits is False
    assert mixed.to_dict()["color_bound_levels"] is None
    assert mixed.shape_bound_m == np.inf or mixed.shape_bound_m <= limits["max_shape"]


def test_a_limit_below_a_loose_bound_is_decided_by_subdivision(bumps):
    loose = {"shape_tolerance": 0.5, "effort": 0.0}
    close = certify(*bumps)
    full = certify(*bumps, **loose)
    limit = (close.shape_attained_m + full.shape_bound_m) / 2
    found = certify(*bumps, max_shape=limit, **loose)
    assert found.shape_bound_m <= full.shape_bound_m
    assert found.within_limits == (found.shape_bound_m <= limit)
