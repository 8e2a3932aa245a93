"""Building blocks of `repair`.

They are a mesh with undoable edits, repair operations, their validation, and the comparison of defects.
"""
