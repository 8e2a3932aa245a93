"""What is missing in a scan: holes, space that no frame saw, and surface that was hardly seen."""
