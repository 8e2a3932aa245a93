"""Registration of frames without poses: odometry, loop closure and pose graph."""
