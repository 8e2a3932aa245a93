"""Artifacts that several stages write or read. An artifact of one stage is in the file of its stage."""
