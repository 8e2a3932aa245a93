"""Method jia01 compared with a slow reference that follows Jia et al. 2001 definition by definition."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh


@dataclass
class Limits:
    length: float
    shape: float
    texture: float
    scale: float
    paper_rule: bool


@dataclass
class Sums:
    """Values S_A and T_A of an edge; T_A is split into the sum of collapses and the initial contrast."""

    shape: float = 0.0
    texture: float = 0.0
    contrast: float = 0.0


@dataclass
class Reference:
    """Reference simplifier on a list of triangles; points are x, y, z, then colour in 8-bit levels."""

    points: dict[int, np.ndarray]
    triangles: list[tuple[int, int, int]]
    limits: Limits
    sums: dict[frozenset[int], Sums] = field(default_factory=dict)
    largest: Sums = field(default_factory=Sums)

    def run(self, target: int, ties: Iterable[frozenset[int]] = ()) -> None:
        """Collapse edges; among edges of equal order, the next of `ties` is first."""
        for edge in self.edges():
            self.sums[edge] = Sums(contrast=self.compute_texture_change(edge))
        chosen = iter(ties)
        while len(self.triangles) > target and self.collapse_first(next(chosen, None)):
            pass

    def collapse_first(self, chosen: frozenset[int] | None) -> bool:
        for edge in sorted(filter(self.is_within_limits, self.edges()), key=self.compute_order):
            if chosen in self.sums and self.compute_order(chosen) <= (1 + 1e-9) * self.compute_order(edge):
                if self.is_within_limits(chosen) and self.collapse(chosen):
                    return True
                chosen = None
            if self.collapse(edge):
                return True
        return False

    # -- splits ------------------------------------------------------------------------------------------

    def split_long_edges(self) -> int:
        """Halve the longest edge until none is longer than L; return the number of splits."""
        count = 0
        while self.length(edge := max(self.edges(), key=self.length)) > self.limits.length:
            self.split(*edge)
            count += 1
        return count

    def split(self, a: int, b: int) -> None:
        new = max(self.points) + 1
        self.points[new] = (self.points[a] + self.points[b]) / 2
        self.triangles = [
            tuple(new if v == old else v for v in t)
            for t in self.triangles
            for old in ((a, b) if {a, b} <= set(t) else (None,))
        ]

    # -- neighbourhoods ----------------------------------------------------------------------------------

    def edges(self) -> set[frozenset[int]]:
        return {frozenset(pair) for t in self.triangles for pair in itertools.combinations(t, 2)}

    def list_star(self, edge: frozenset[int]) -> list[tuple[int, int, int]]:
        return [t for t in self.triangles if edge & set(t)]

    def list_neighbours(self, vertex: int) -> set[int]:
        return {w for t in self.triangles if vertex in t for w in t} - {vertex}

    def boundary(self) -> set[frozenset[int]]:
        sides = Counter(frozenset(pair) for t in self.triangles for pair in itertools.combinations(t, 2))
        return {edge for edge, triangles in sides.items() if triangles == 1}

    def get_position(self, vertex: int) -> np.ndarray:
        return self.points[vertex][:3]

    # -- definitions -------------------------------------------------------------------------------------

    def length(self, edge: frozenset[int]) -> float:
        a, b = edge
        return float(np.linalg.norm(self.get_position(a) - self.get_position(b)))

    def compute_texture_change(self, edge: frozenset[int]) -> float:
        """Compute T(e), equation (3): the largest difference along any edge of the neighbourhood."""
        pairs = {frozenset(p) for t in self.list_star(edge) for p in itertools.combinations(t, 2)}
        return max(float(np.linalg.norm(self.points[a][3:] - self.points[b][3:])) for a, b in pairs)

    def compute_order(self, edge: frozenset[int]) -> float:
        """Compute E, equation (7)."""
        sums, limits = self.sums[edge], self.limits
        total = sums.contrast + sums.texture
        return (
            (sums.shape / limits.shape + 1)
            * (total / limits.texture + 1)
            * (self.length(edge) / limits.length + 1)
        )

    def is_within_limits(self, edge: frozenset[int]) -> bool:
        """Check that none of the three conditions removes the edge from the queue."""
        sums, limits = self.sums[edge], self.limits
        return (
            self.length(edge) <= limits.length
            and sums.shape <= limits.shape
            and sums.contrast + sums.texture <= limits.texture
        )

    def compute_placement(self, edge: frozenset[int]) -> np.ndarray:
        """Compute the new vertex, equations (4) to (6).

        At a boundary, lines of boundary edges replace planes.
        """
        a, b = edge
        stretch = np.array([1.0] * 3 + [self.limits.scale] * (len(self.points[a]) - 3))
        middle = (self.points[a] + self.points[b]) / 2 * stretch
        boundary = self.boundary()
        on_boundary = [v for v in edge if any(v in e for e in boundary)]
        if len(on_boundary) == 1:
            return self.points[on_boundary[0]]
        if edge in boundary:
            feet = [
                project_onto_line(middle, *(self.points[v] * stretch for v in e))
                for e in boundary
                if e & edge
            ]
        else:
            corners = [[self.points[v] * stretch for v in t] for t in self.list_star(edge)]
            feet = [project_onto_hyperplane(middle, *c) for c in corners]
        return np.mean(feet, axis=0) / stretch

    def compute_shape_change(self, edge: frozenset[int], new: np.ndarray) -> float:
        """Compute S(e), equations (1) and (2).

        By default, the gap of the stars at crossings of their edges counts as well.
        """
        a, b = edge
        old_star = [[self.get_position(v) for v in t] for t in self.list_star(edge)]
        new_star = [[new[:3] if v in edge else self.get_position(v) for v in t] for t in self.list_kept(edge)]
        there = [min(measure_distance_to_triangle(self.get_position(v), t) for t in new_star) for v in (a, b)]
        back = min(measure_distance_to_triangle(new[:3], t) for t in old_star)
        change = max(*there, back)
        boundary = self.boundary()
        if edge in boundary:
            old_line = [[self.get_position(v) for v in e] for e in boundary if e & edge]
            new_line = [
                [new[:3] if v in edge else self.get_position(v) for v in e]
                for e in boundary
                if len(e & edge) == 1
            ]
            there = [
                min(measure_distance_to_segment(self.get_position(v), *s) for s in new_line) for v in (a, b)
            ]
            change = max(change, *there, min(measure_distance_to_segment(new[:3], *s) for s in old_line))
        if self.limits.paper_rule:
            return change
        normal = sum(np.cross(t[1] - t[0], t[2] - t[0]) for t in old_star)
        if any(np.cross(t[1] - t[0], t[2] - t[0]) @ normal < 0 for t in [*old_star, *new_star]):
            # The star folds. Moving both ends and their triangles to the new vertex moves no point farther.
            return max(change, *(float(np.linalg.norm(new[:3] - self.get_position(v))) for v in (a, b)))
        return max(change, self.compute_crossing_gap(edge, new))

    def compute_crossing_gap(self, edge: frozenset[int], new: np.ndarray) -> float:
        normal = sum(
            np.cross(
                self.get_position(t[1]) - self.get_position(t[0]),
                self.get_position(t[2]) - self.get_position(t[0]),
            )
            for t in self.list_star(edge)
        )
        normal = normal / np.linalg.norm(normal)
        ring = {v for t in self.list_star(edge) for v in t} - edge
        old = [
            (self.get_position(v), self.get_position(w)) for v in edge for w in self.list_neighbours(v) - edge
        ]
        old.append(tuple(self.get_position(v) for v in edge))
        gaps = [0.0]
        for (p, q), w in itertools.product(old, ring):
            # The point p + t (q − p) is above or below new + u (w − new), at distance g.
            across = np.stack([q - p, new[:3] - self.get_position(w), -normal], axis=1)
            if abs(np.linalg.det(across)) > 1e-12:
                t, u, g = np.linalg.solve(across, new[:3] - p)
                if 0 <= t <= 1 and 0 <= u <= 1:
                    gaps.append(abs(g))
        return max(gaps)

    # -- legality of a collapse --------------------------------------------------------------------------

    def list_kept(self, edge: frozenset[int]) -> list[tuple[int, int, int]]:
        return [t for t in self.list_star(edge) if len(edge & set(t)) == 1]

    def is_legal(self, edge: frozenset[int], new: np.ndarray) -> bool:
        a, b = edge
        boundary = self.boundary()
        apexes = {v for t in self.triangles if edge <= set(t) for v in t} - edge
        if self.list_neighbours(a) & self.list_neighbours(b) != apexes:
            return False
        if edge not in boundary and all(any(v in e for e in boundary) for v in edge):
            return False
        if len(self.list_kept(edge)) <= 2 and not boundary:
            return False  # a tetrahedron
        for t in self.list_kept(edge):
            old = [self.get_position(v) for v in t]
            moved = [new[:3] if v in edge else self.get_position(v) for v in t]
            normal, turned = (np.cross(c[1] - c[0], c[2] - c[0]) for c in (old, moved))
            if normal @ turned < 0.25 * np.linalg.norm(normal) * np.linalg.norm(turned):
                return False
            longest = max(np.linalg.norm(moved[i] - moved[i - 1]) for i in range(3))
            if np.linalg.norm(turned) < 1e-3 * longest**2:
                return False
        return True

    # -- one collapse ------------------------------------------------------------------------------------

    def collapse(self, edge: frozenset[int]) -> bool:
        new = self.compute_placement(edge)
        if not self.is_legal(edge, new):
            return False
        shape, texture = self.compute_shape_change(edge, new), self.compute_texture_change(edge)
        least = 0.0
        around = [e for e in self.edges() if any(e <= set(t) for t in self.list_star(edge)) and e != edge]
        limits, own = self.limits, self.sums[edge]
        if not limits.paper_rule:
            receiving = [self.sums[e] for e in around]
            # Any point of the old star may be moved into any triangle of the new star.
            least = max(s.shape for s in [own, *receiving]) + shape
            if least > limits.shape:
                return False
            if max(own.contrast + own.texture, *(s.texture for s in receiving)) + texture > limits.texture:
                return False
        survivor = min(edge, key=lambda v: np.linalg.norm(self.get_position(v) - new[:3]))
        (removed,) = edge - {survivor}
        for e in around:
            sums = self.sums[e]
            sums.shape += shape
            sums.texture += texture
            self.largest.shape = max(self.largest.shape, sums.shape)
            self.largest.texture = max(self.largest.texture, sums.texture)
        self.triangles = [
            tuple(survivor if v == removed else v for v in t) for t in self.triangles if not edge <= set(t)
        ]
        self.points[survivor] = new
        del self.points[removed]
        before, self.sums = self.sums, {}
        for e, sums in before.items():
            if e == edge:
                continue
            now = frozenset(survivor if v == removed else v for v in e)
            twin = self.sums.get(now, sums)
            self.sums[now] = Sums(
                max(sums.shape, twin.shape),
                max(sums.texture, twin.texture),
                max(sums.contrast, twin.contrast),
            )
        for e, sums in self.sums.items():
            if survivor in e:
                sums.shape = max(sums.shape, least)
                self.largest.shape = max(self.largest.shape, sums.shape)
        return True


def project_onto_hyperplane(m: np.ndarray, p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Evaluate equations (4) to (6) literally: Gram-Schmidt, the normal n3, and m − n d."""
    h, k, l = q - p, r - p, m - p  # noqa: E741 - letters of the paper
    n1 = h / np.linalg.norm(h)
    n2 = k - (n1 @ k) * n1
    n2 = n2 / np.linalg.norm(n2)
    n3 = l - (n1 @ l) * n1 - (n2 @ l) * n2
    if np.linalg.norm(n3) < 1e-9 * np.linalg.norm(l):
        return m  # m is on the plane of the triangle
    n = n3 / np.linalg.norm(n3)
    d = n @ m - n @ p
    return m - n * d


def project_onto_line(m: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    n1 = (q - p) / np.linalg.norm(q - p)
    return p + (n1 @ (m - p)) * n1


def measure_distance_to_segment(x: np.ndarray, p: np.ndarray, q: np.ndarray) -> float:
    t = np.clip((x - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)
    return float(np.linalg.norm(x - p - t * (q - p)))


def measure_distance_to_triangle(x: np.ndarray, corners: list[np.ndarray]) -> float:
    p, q, r = corners
    b, c = np.linalg.lstsq(np.stack([q - p, r - p], axis=1), x - p, rcond=None)[0]
    if b >= 0 and c >= 0 and b + c <= 1:
        return float(np.linalg.norm(x - p - b * (q - p) - c * (r - p)))
    return min(
        measure_distance_to_segment(x, p, q),
        measure_distance_to_segment(x, q, r),
        measure_distance_to_segment(x, r, p),
    )


def make_ball() -> tuple[np.ndarray, np.ndarray]:
    """Make an octahedron with every triangle divided into four, twice."""
    corners = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    faces = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 0, 5], [2, 1, 5], [3, 2, 5], [0, 3, 5]]
    points = [*corners]
    middles: dict[frozenset[int], int] = {}

    def get_middle(a: int, b: int) -> int:
        if frozenset((a, b)) not in middles:
            middles[frozenset((a, b))] = len(points)
            points.append((points[a] + points[b]) / 2)
        return middles[frozenset((a, b))]

    for _ in range(2):
        coarse, faces = faces, []
        for a, b, c in coarse:
            ab, bc, ca = get_middle(a, b), get_middle(b, c), get_middle(c, a)
            faces += [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    vertices = np.array(points)
    return vertices / np.linalg.norm(vertices, axis=1)[:, None], np.array(faces, np.int32)


def make_sheet(n: int) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[0 : n + 1, 0 : n + 1]
    vertices = np.stack([x, y, 0 * x], -1).reshape(-1, 3) / n
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    b, c, d = a + 1, a + n + 2, a + n + 1
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)


def make_noisy_mesh(shape: str, seed: int) -> Mesh:
    noise = np.random.default_rng(seed)
    vertices, triangles = make_ball() if shape == "ball" else make_sheet(5)
    vertices = vertices + noise.normal(0, 0.03, vertices.shape)
    base = 128 + 60 * np.sin(3 * vertices)
    colors = (base + noise.normal(0, 6, base.shape)).clip(0, 255).astype(np.uint8)
    return Mesh(vertices, triangles, colors=colors)


def compare_with_reference(mesh: Mesh, limits: Limits, target: int) -> None:
    reference = Reference(
        {i: np.concatenate([v, c]) for i, (v, c) in enumerate(zip(mesh.vertices, mesh.colors, strict=True))},
        [tuple(t) for t in mesh.triangles.tolist()],
        limits,
    )
    reference.run(target)
    result = simplify(
        mesh,
        max_shape=limits.shape,
        max_color=limits.texture,
        attribute_scale=limits.scale,
        triangles=target,
        jia01={"resolution": limits.length, "paper_rule": limits.paper_rule},
    )
    assert result.details.splits == 0
    assert result.collapses == len(mesh.vertices) - len(reference.points)
    assert result.vertex_source.tolist() == sorted(reference.points)
    expected = np.array([reference.points[v] for v in sorted(reference.points)])
    np.testing.assert_allclose(result.mesh.vertices, expected[:, :3], atol=1e-9)
    np.testing.assert_allclose(result.mesh.colors, expected[:, 3:].clip(0, 255), atol=0.5 + 1e-6)
    assert sort_triangles(result.vertex_source[result.mesh.triangles]) == sort_triangles(reference.triangles)
    assert result.details.largest_shape_change_m == pytest.approx(reference.largest.shape, abs=1e-12)
    # The reference converts colours to lengths and back. Its rounding error grows for smaller scales, and
    # with the number of summed contrasts of about a hundred levels each.
    rounding = (1e-9 + 1e-13 / limits.scale) * (1 + reference.largest.texture / 100)
    assert result.details.largest_color_change_levels == pytest.approx(
        reference.largest.texture, abs=rounding
    )


def sort_triangles_by_position(points: np.ndarray, triangles) -> list[tuple[tuple[float, ...], ...]]:
    """Return triangles as points, independent of vertex indices, starting corners and order."""
    corners = [[tuple(points[v].tolist()) for v in t] for t in triangles]
    return sorted(min(tuple(t[i:] + t[:i]) for i in range(3)) for t in corners)


def sort_triangles(triangles) -> list[tuple[int, ...]]:
    """Return triangles independent of their starting corners and order."""
    return sorted(tuple(np.roll(t, -int(np.argmin(t))).tolist()) for t in triangles)


SLOW = settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))


@SLOW
@given(shape=st.sampled_from(["ball", "sheet"]), seed=st.integers(0, 2**31), paper_rule=st.booleans())
def test_the_first_collapse_follows_the_paper(shape: str, seed: int, paper_rule: bool) -> None:
    """A single collapse tests the order (7), placement (4)-(6), S (1)-(2) and T (3)."""
    mesh = make_noisy_mesh(shape, seed)
    limits = Limits(length=3.0, shape=1.0, texture=5000.0, scale=1e-3, paper_rule=paper_rule)
    compare_with_reference(mesh, limits, len(mesh.triangles) - 1)


@pytest.mark.slow
@SLOW
@given(
    shape=st.sampled_from(["ball", "sheet"]),
    seed=st.integers(0, 2**31),
    paper_rule=st.booleans(),
    length=st.sampled_from([0.95, 2.0]),
    max_shape=st.sampled_from([0.03, 0.2]),
    max_color=st.sampled_from([250.0, 1500.0]),
    scale=st.sampled_from([1e-6, 1e-4, 1e-2]),
)
def test_a_whole_run_follows_the_paper(
    shape: str, seed: int, paper_rule: bool, length: float, max_shape: float, max_color: float, scale: float
) -> None:
    """The run tests accumulation, merged edges, stop rules and reconsidered edges until its end."""
    compare_with_reference(
        make_noisy_mesh(shape, seed), Limits(length, max_shape, max_color, scale, paper_rule), target=1
    )


@pytest.mark.parametrize("shape", ["sheet", pytest.param("ball", marks=pytest.mark.slow)])
@settings(SLOW, max_examples=3)
@given(
    seed=st.integers(0, 2**31),
    paper_rule=st.booleans(),
    max_color=st.sampled_from([250.0, 1500.0]),
    is_grey=st.booleans(),
)
def test_splits_and_collapses_follow_the_paper(
    shape: str, seed: int, paper_rule: bool, max_color: float, is_grey: bool
) -> None:
    """Splits are first, the longest edge first, at midpoints; collapses follow."""
    mesh = make_noisy_mesh(shape, seed)
    # Rounded, so that levels at midpoints are integers, as stored in the record.
    colors = mesh.colors // 16 * 16
    if is_grey:
        mesh = mesh.with_(colors=np.repeat(colors[:, :1], 3, axis=1), intensity_max=255.0)
    else:
        mesh = mesh.with_(colors=colors)
    channels = 1 if is_grey else 3
    sides = mesh.vertices[mesh.triangles] - mesh.vertices[np.roll(mesh.triangles, 1, axis=1)]
    # Between two lengths, because an edge of exactly this length may be longer by rounding.
    length = float(np.unique(np.linalg.norm(sides, axis=2))[-6:-4].mean())
    limits = Limits(length, 0.05, max_color, 1e-4, paper_rule)

    def start(given: Mesh) -> Reference:
        points = np.concatenate([given.vertices, given.colors[:, :channels]], axis=1)
        return Reference(dict(enumerate(points)), [tuple(t) for t in given.triangles.tolist()], limits)

    split = start(mesh)
    splits = split.split_long_edges()
    target = len(split.triangles) - 12
    result = simplify(
        mesh,
        max_shape=limits.shape,
        max_color=max_color,
        attribute_scale=limits.scale,
        triangles=target,
        jia01={"resolution": length, "paper_rule": paper_rule},
        record=True,
    )

    record = result.record
    assert result.details.splits == splits > 0
    reference = start(record.mesh)
    assert sort_triangles_by_position(reference.points, reference.triangles) == sort_triangles_by_position(
        split.points, split.triangles
    )
    pairs = zip(record.removed.tolist(), record.survivor.tolist(), strict=True)
    reference.run(target, map(frozenset, pairs))
    assert result.collapses == len(record.mesh.vertices) - len(reference.points)
    places = sorted(reference.points.values(), key=tuple)
    ours = np.concatenate([result.mesh.vertices, result.mesh.colors[:, :channels]], axis=1)
    ours = ours[np.lexsort(ours.T[::-1])]
    np.testing.assert_allclose(ours[:, :3], np.array(places)[:, :3], atol=1e-9)
    np.testing.assert_allclose(ours[:, 3:], np.array(places)[:, 3:], atol=0.5 + 1e-6)
    assert len(result.mesh.triangles) == len(reference.triangles)
