"""Normal meshes: remeshing and the progressive `.snm` file format."""
