"""Normal meshes (LI02): remeshing, and the file of their levels."""
