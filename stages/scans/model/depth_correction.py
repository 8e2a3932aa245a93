"""Smooth correction of measured depth over image position and range.

Sensors bend depth by 0.5 to 2 % (Teichman, Miller and Thrun 2013; Basso et al. 2018). The corrected depth is
z (1 + s(x, y, t)). The relative correction s is a product basis: Legendre polynomials of the image position
(x, y) up to a total degree, times 1 or t, where t grows linearly with depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

# Maximum total degree of the polynomials in image position.
DEGREE = 4
# Exponents of x and y, by total degree. The first function is constant.
_ORDERS = tuple((total - n, n) for total in range(DEGREE + 1) for n in range(total + 1))
# Functions of image position, and number of coefficients: each function times 1, then each times t.
POSITION_COUNT = len(_ORDERS)
COEFFICIENT_COUNT = 2 * POSITION_COUNT


@dataclass(frozen=True)
class DepthCorrection:
    """Relative correction of depth for one sensor.

    Attributes
    ----------
    width, height : size in pixels of the depth maps that the correction was estimated for. Depth maps of
        another size are mapped to the same field of view.
    near_m, far_m : depth range of the estimate, metres. The correction is constant beyond it.
    coefficients : `COEFFICIENT_COUNT` values without unit: products of Legendre polynomials in x and y by
        total degree, then the same products times t. x, y and t are -1 and 1 at the ends of image and range.
    """

    width: int
    height: int
    near_m: float
    far_m: float
    coefficients: tuple[float, ...]

    def compute_basis(
        self, columns: NDArray[np.floating], rows: NDArray[np.floating], depth: NDArray[np.floating]
    ) -> NDArray[np.float64]:
        """Compute the basis functions at pixels.

        Parameters
        ----------
        columns, rows : (n,) pixels of a depth map of `width` × `height`, without lens distortion.
        depth : (n,) measured depth, metres.

        Returns
        -------
        (n, COEFFICIENT_COUNT) derivatives of the relative correction by the coefficients.
        """
        position = _evaluate_products((2 * columns + 1) / self.width - 1, (2 * rows + 1) / self.height - 1)
        return np.concatenate([position, position * self._to_range(depth)[:, None]], axis=1)

    def correct_at(
        self, columns: NDArray[np.floating], rows: NDArray[np.floating], depth: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Correct the depth (n,) at pixels, see `compute_basis`; 0 stays 0."""
        basis = self.compute_basis(columns, rows, depth)
        return np.asarray(depth * (1 + basis @ np.asarray(self.coefficients)))

    def correct_map(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Correct a depth map (h, w) in metres; 0 stays 0."""
        height, width = depth.shape
        base, slope = _compute_position_maps(self.coefficients, width, height)
        return depth * (1 + base + slope * self._to_range(depth).astype(np.float32))

    def scale_depth(self, factor: float) -> DepthCorrection:
        """Return the correction with corrected depth multiplied by a factor."""
        values = [factor * value for value in self.coefficients]
        values[0] += factor - 1
        return replace(self, coefficients=tuple(values))

    def compute_range_percent(self) -> tuple[float, float]:
        """Compute the smallest and largest correction in percent, over image and range."""
        base, slope = _compute_position_maps(self.coefficients, 65, 49)
        ends = np.stack([base - slope, base + slope])
        return 100 * float(ends.min()), 100 * float(ends.max())

    def _to_range(self, depth: NDArray[np.floating]) -> NDArray[np.floating]:
        middle, half = (self.far_m + self.near_m) / 2, (self.far_m - self.near_m) / 2
        return np.asarray(np.clip((depth - middle) / half, -1, 1))


def _evaluate_products(x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float64]:
    """Evaluate the products of Legendre polynomials (n, POSITION_COUNT) at positions (n,)."""
    across, down = (np.polynomial.legendre.legvander(np.asarray(v, np.float64), DEGREE) for v in (x, y))
    return np.stack([across[..., i] * down[..., j] for i, j in _ORDERS], axis=-1)


@lru_cache(maxsize=8)
def _compute_position_maps(
    coefficients: tuple[float, ...], width: int, height: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute the parts (h, w) of the correction that are constant and linear in t."""
    x, y = (2 * np.arange(width) + 1) / width - 1, (2 * np.arange(height) + 1) / height - 1
    across, down = (np.polynomial.legendre.legvander(v, DEGREE) for v in (x, y))
    parts = []
    for some in (coefficients[:POSITION_COUNT], coefficients[POSITION_COUNT:]):
        table = np.zeros((DEGREE + 1, DEGREE + 1))
        for (i, j), value in zip(_ORDERS, some, strict=True):
            table[j, i] = value
        # einsum adds in a fixed order, unlike matrix products on several threads.
        parts.append(np.einsum("rj,ji,ci->rc", down, table, across, optimize=False).astype(np.float32))
    return parts[0], parts[1]
