"""What `repair` is made of: a mesh whose edits can be undone, the edits, who judges them, who proves them."""
