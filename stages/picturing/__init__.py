"""Pictures of meshes, and where they are taken from."""
