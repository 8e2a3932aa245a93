"""Structure from motion: camera poses and intrinsics from photos alone."""
