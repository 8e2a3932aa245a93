"""Export of meshes for other programs: axes, units, compression and file formats."""
