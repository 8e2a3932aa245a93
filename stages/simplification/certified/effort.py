"""Constants that both variants of method `certified` share."""

from __future__ import annotations

# Ratio of the bounds that vertices may use at first. The remainder is for the points between them.
SHARE_OF_VERTICES = 0.9

# Expected reduction under typical bounds, for which the colour weight is computed. A smaller expected
# reduction gives about the same weight.
REDUCTION = 8

# Relative gap between a proven bound and the largest deviation found, at which the proof of a triangle stops,
# and the maximum number of subdivisions per triangle.
TOLERANCE = 0.05
PIECES = 16.0

# Minimum bound on colour, levels: colours are stored as whole levels.
LEAST_COLOR = 0.5
