"""Names of result files and folders that pages read."""

# Pictures, cameras and photos of the report.
PICTURES = "pictures"
# Per-texel maps of the texture: number of photos, and index of the photo with the largest weight.
TEXTURE_MAPS = "texture_maps"
# Mesh coloured by coverage, and list of gaps.
COVERAGE_MESH, COVERAGE = "coverage.ply", "coverage.json"
# Vertex property of refined.ply, 1 inside of filled holes.
FILLED_PROPERTY = "filled"
