"""Total variation and second-order total generalised variation of a field on voxels.

Minimises R(u) + λ × data cost of u over fields u by the first-order primal-dual method. R is

- order 1: Σ |∇u|, the total variation. It prefers constant fields and level sets of small area.
- order 2: min over w of Σ |∇u − w| + α Σ |E w| with the symmetrised gradient E. It prefers affine fields.

Norms are Euclidean over the components. ∇ has forward differences, E has backward differences. Differences to
voxels outside the field are 0 and do not constrain w. Lengths are in voxels.

References
----------
Bredies, Kunisch and Pock, "Total generalized variation", 2010; Chambolle and Pock, "A first-order primal-dual
algorithm for convex problems with applications to imaging", 2011; Pock and Chambolle, "Diagonal
preconditioning for first order primal-dual algorithms in convex optimization", 2011 (step sizes).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from peers.data_terms import DataTerm, Floats

Positions = NDArray[np.int32]
Indices = NDArray[np.int64]

# α, in voxels.
_SECOND_ORDER_WEIGHT = 2.0
_ITERATIONS = 300
# Pairs of components of a symmetric matrix. Mixed components count twice in the norm, hence √2.
_COMPONENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


class VoxelOperators:
    """Difference operators on a set of voxels, as sparse matrices.

    Attributes
    ----------
    gradient : (3 n, n) forward differences, axis by axis.
    has_next : (3, n), 1 where the difference exists, otherwise 0.
    symmetrised : (6 n, 3 n) symmetrised gradient of a vector field.

    Parameters
    ----------
    positions : (n, 3) distinct voxel coordinates.
    """

    def __init__(self, positions: Positions) -> None:
        import scipy.sparse

        following = find_neighbours(positions)
        forward = [_make_differences(indices) for indices in following]
        backward = [_make_differences(_invert(indices)) * np.float32(-1) for indices in following]
        blocks: list[list[Any]] = [[None] * 3 for _ in _COMPONENTS]
        for row, (i, k) in zip(blocks, _COMPONENTS, strict=True):
            factor = np.float32(1 if i == k else 0.5**0.5)
            row[i], row[k] = backward[k] * factor, backward[i] * factor
        self.gradient = scipy.sparse.vstack(forward, format="csr")
        self.symmetrised = scipy.sparse.bmat(blocks, format="csr")
        self.has_next = (following >= 0).astype(np.float32)


def find_neighbours(positions: Positions) -> Indices:
    """Find the index (3, n) of the next voxel along each axis; −1 at the end."""
    low = positions.min(axis=0).astype(np.int64)
    size = positions.max(axis=0) - low + 2
    keys = np.ravel_multi_index(tuple((positions - low).T), tuple(size))
    order = np.argsort(keys)
    sorted_keys = keys[order]
    following = []
    for axis in range(3):
        wanted = keys + np.prod(size[axis + 1 :])
        found = np.minimum(np.searchsorted(sorted_keys, wanted), len(keys) - 1)
        following.append(np.where(sorted_keys[found] == wanted, order[found], -1))
    return np.stack(following)


def _invert(following: Indices) -> Indices:
    """Return the index (n,) of the voxel before each one; −1 at the start."""
    before = np.full(len(following), -1)
    found = np.flatnonzero(following >= 0)
    before[following[found]] = found
    return before


def _make_differences(others: Indices) -> Any:
    """Return the sparse matrix (n, n) of differences from each voxel to another; 0 for index −1."""
    import scipy.sparse

    count = len(others)
    rows = np.flatnonzero(others >= 0).astype(np.int32)
    columns = np.stack([rows, others[rows].astype(np.int32)], axis=1).ravel()
    values = np.tile(np.array((-1, 1), np.float32), len(rows))
    starts = np.concatenate([[0], np.cumsum(2 * (others >= 0))]).astype(np.int32)
    return scipy.sparse.csr_matrix((values, columns, starts), (count, count))


def minimise(
    operators: VoxelOperators,
    data: DataTerm,
    data_weight: float,
    *,
    order: int,
    iterations: int = _ITERATIONS,
    energies: list[float] | None = None,
) -> Floats:
    """Minimise the energy, starting from the mean of the measurements.

    Parameters
    ----------
    data_weight : λ.
    order : 1 for total variation, 2 for total generalised variation.
    energies : receives the energy before the first and after each iteration.

    Returns
    -------
    The field (n,).
    """
    if order not in (1, 2):
        raise ValueError(f"order must be 1 or 2, but is {order}")
    gradient, symmetrised, has_next = operators.gradient, operators.symmetrised, operators.has_next
    is_affine = order == 2
    field = data.compute_mean()
    slopes = (gradient @ field).reshape(3, -1) if is_affine else np.zeros_like(has_next)
    flux, stress = np.zeros_like(has_next), np.zeros((len(_COMPONENTS), len(field)), np.float32)
    # Steps are inverse sums of the absolute entries of columns and rows.
    flux_step, field_step = np.float32(1 / 3 if is_affine else 1 / 2), np.float32(1 / 6)
    stress_step, slopes_step = np.float32(0.5**1.5), np.float32(1 / (3 + 2 * 2**0.5))
    leading_field, leading_slopes = field, slopes

    def record() -> None:
        if energies is not None:
            smoothness = _compute_smoothness(operators, field, slopes)
            energies.append(smoothness + data_weight * data.compute_cost(field))

    record()
    for _ in range(iterations):
        residuals = (gradient @ leading_field).reshape(3, -1)
        if is_affine:
            residuals -= has_next * leading_slopes
        flux += flux_step * residuals
        _project(flux, 1)
        moved = data.apply_proximal(
            field - field_step * (gradient.T @ flux.ravel()), float(field_step) * data_weight
        )
        leading_field, field = 2 * moved - field, moved
        if is_affine:
            stress += stress_step * (symmetrised @ leading_slopes.ravel()).reshape(stress.shape)
            _project(stress, _SECOND_ORDER_WEIGHT)
            change = (symmetrised.T @ stress.ravel()).reshape(3, -1)
            change -= has_next * flux
            moved = slopes - slopes_step * change
            leading_slopes, slopes = 2 * moved - slopes, moved
        record()
    return field


def _project(vectors: Floats, radius: float) -> None:
    """Shorten vectors (components, n) to a maximum length, in place."""
    lengths = np.sqrt(np.einsum("cn,cn->n", vectors, vectors))
    vectors /= np.maximum(lengths / np.float32(radius), 1)


def _compute_smoothness(operators: VoxelOperators, field: Floats, slopes: Floats) -> float:
    """Compute R for a field (n,) and w (3, n); w is 0 for order 1."""
    residuals = (operators.gradient @ field).reshape(3, -1) - operators.has_next * slopes
    bends = (operators.symmetrised @ slopes.ravel()).reshape(len(_COMPONENTS), -1)
    first, second = (float(np.linalg.norm(terms, axis=0).sum()) for terms in (residuals, bends))
    return first + _SECOND_ORDER_WEIGHT * second
