"""Cache of stage results: entries, keys, locks."""
