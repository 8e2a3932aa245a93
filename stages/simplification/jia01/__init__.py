"""Method `jia01`: texture-preserving simplification with bounds on sums (Jia and others 2001)."""
