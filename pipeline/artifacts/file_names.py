"""Names of files and folders in the output folder that steps write and pages read."""

# Pictures, cameras and photos of the report.
PICTURES = "pictures"
# Number of photos and photo with the most weight, for each texel of the texture.
TEXTURE_MAPS = "texture_maps"
# Mesh and list of the gaps of a scan.
COVERAGE_MESH, COVERAGE = "coverage.ply", "coverage.json"
