"""Scans: frames, images and videos; `table` lists the supported layouts, `read` reads scan folders."""
