"""Mesh data model: arrays, textures, topology, file formats, conversions and ray queries."""
