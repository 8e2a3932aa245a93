"""Splits where sheets touch: all sheets get the same vertices, so that there are no T-junctions."""

from __future__ import annotations

import itertools
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from scanloom import Mesh, simplify


def make_book(
    along: NDArray[np.float64], pages: int, columns: int, rng: np.random.Generator, height: float
) -> Mesh:
    """Make bumpy pages with a common spine: the z axis at the positions `along`."""
    spine = np.stack([0 * along, 0 * along, along], axis=1)
    vertices, triangles = [spine], []
    first = len(spine)
    for page in range(pages):
        angle = 2 * np.pi * page / pages
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        across = np.array([-np.sin(angle), np.cos(angle), 0.0])
        ids = [np.arange(len(spine))]
        for column in range(1, columns + 1):
            bump = height * rng.standard_normal(len(spine))
            vertices.append(spine + column * out + bump[:, None] * across)
            ids.append(first + np.arange(len(spine)))
            first += len(spine)
        for left, right in itertools.pairwise(ids):
            a, b, c, d = left[:-1], right[:-1], right[1:], left[1:]
            triangles += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    return Mesh(np.concatenate(vertices), np.concatenate(triangles).astype(np.int32))


def find_spine_edges(mesh: Mesh) -> dict[tuple[float, float], int]:
    """Count the triangles at each edge on the z axis, by the heights of its ends."""
    on_axis = (mesh.vertices[:, :2] == 0).all(axis=1)
    counts: Counter[tuple[float, float]] = Counter()
    for triangle in mesh.triangles:
        for a, b in zip(triangle, np.roll(triangle, -1), strict=True):
            if on_axis[a] and on_axis[b]:
                low, high = sorted((float(mesh.vertices[a, 2]), float(mesh.vertices[b, 2])))
                counts[low, high] += 1
    return counts


def test_the_smallest_book_is_split_equally_on_all_pages() -> None:
    points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0.5], [-0.5, 0.9, 0.5], [-0.5, -0.9, 0.5]], float)
    book = Mesh(points, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], np.int32))

    result = simplify(book, method="jia01", max_shape=1.0, jia01={"resolution": 0.3})

    assert result.details.splits > 0
    quarters = [(0.0, 0.25), (0.25, 0.5), (0.5, 0.75), (0.75, 1.0)]
    assert find_spine_edges(result.mesh) == dict.fromkeys(quarters, 3)


@pytest.mark.parametrize("color", [None, 90])
@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    pages=st.integers(3, 5),
    rows=st.integers(2, 6),
    resolution=st.floats(0.25, 3.0),
    height=st.sampled_from([0.0, 0.05]),
)
def test_pages_stay_connected_along_their_spine(
    color: int | None, seed: int, pages: int, rows: int, resolution: float, height: float
) -> None:
    rng = np.random.default_rng(seed)
    along = np.cumsum(rng.uniform(0.4, 2.0, rows))
    book = make_book(along, pages, 3, rng, height)
    if color is not None:
        book = book.with_(colors=np.full((len(book.vertices), 3), color, np.uint8))

    result = simplify(book, method="jia01", max_shape=0.5, max_color=1e6, jia01={"resolution": resolution})

    edges = find_spine_edges(result.mesh)
    assert set(edges.values()) == {pages}
    ends = sorted(edges)
    assert [low for low, _ in ends[1:]] == [high for _, high in ends[:-1]]
    assert (ends[0][0], ends[-1][1]) == (along[0], along[-1])
    assert set(along) <= {height for edge in ends for height in edge}
    lengths = np.array([high - low for low, high in ends])
    assert (lengths <= resolution).all()


def test_pages_are_simplified_although_their_spine_is_split() -> None:
    """Parts of the split spine are not new contacts, whose neighbouring vertices would be locked."""
    book = make_book(np.arange(0, 40, 4.0), 3, 40, np.random.default_rng(5), 0.0)

    result = simplify(book, method="jia01", max_shape=0.5, jia01={"resolution": 3.5})

    assert result.details.splits > 0
    assert len(result.mesh.triangles) < 0.5 * len(book.triangles)
