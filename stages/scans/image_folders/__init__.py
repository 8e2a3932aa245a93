"""Folders of images: names, pairing, depth units and depth encodings."""
