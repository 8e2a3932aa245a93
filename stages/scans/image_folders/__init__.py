"""Folders of images: names, pairing, units and pictures of depth."""
