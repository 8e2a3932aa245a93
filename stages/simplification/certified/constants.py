"""Constants that both variants of method `certified` share."""

from __future__ import annotations

# Ratio of the bounds that vertices may use at first. The remainder is for the points between them.
VERTEX_BOUND_RATIO = 0.9

# Expected reduction under typical bounds, for which the colour weight is computed. A smaller expected
# reduction gives about the same weight.
EXPECTED_REDUCTION = 8

# Relative gap between a proven bound and the largest deviation found, at which the proof of a triangle stops,
# and the maximum number of subdivisions per triangle.
PROOF_TOLERANCE = 0.05
MAX_SUBDIVISIONS = 16.0

# Minimum bound on colour, levels: colours are stored as whole levels.
MIN_COLOR_BOUND = 0.5
