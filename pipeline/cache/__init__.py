"""Cache of results: entries, keys, locks."""
