"""What the fuse stage is made of: from posed depth maps to a volume and the mesh in it."""
