"""Pages of runs and of comparisons."""
