"""What a mesh is: its arrays, texture, edges, topology, conversions, rays, the colour at a point."""
