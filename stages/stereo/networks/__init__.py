"""A network of the user's own that tells depth from images: its file, what it wants, how it is run."""
