"""What the parameters of method `seams` are where they are not given."""

TEXTURE_WEIGHT = 0.5
NORMAL_WEIGHT = 1.0
SHAPE_WEIGHT = 1.0
ACROSS_TEXTURES = 0.5
ACROSS_PARTS = 0.5
VALENCE_PENALTY = 0.1
SET_PENALTY = 0.1

# Share of the bounding box's diagonal within which vertices are one: what single precision leaves of it.
SIMILAR_DISTANCE = 1e-6
