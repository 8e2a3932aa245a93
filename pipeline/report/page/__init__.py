"""Browser pages that draw results: sources, and bundled libraries."""
