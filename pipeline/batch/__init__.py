"""Many scans: found in a folder, queued, and run by any number of workers on any number of machines."""
