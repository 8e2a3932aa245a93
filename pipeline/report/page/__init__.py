"""Pages that draw results in a browser: their sources, and the libraries they share as one file."""
