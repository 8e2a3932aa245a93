"""How hard method `certified` tries, whatever corners carry."""

from __future__ import annotations

# Part of the bounds that vertices may use at first; what is left is for the points between them.
SHARE_OF_VERTICES = 0.9

# Common bounds leave about an eighth of a scan; the weight of colour is found for triangles of that size,
# also where more are wanted: smaller ones tell the same.
REDUCTION = 8

# How close the bounds of a proof come to what is found, relative to that, and how many pieces a triangle this
# may take.
TOLERANCE = 0.05
PIECES = 16.0

# The least bound on colour, levels: colours are stored in whole ones.
LEAST_COLOR = 0.5
