"""Batch processing: find scans in a folder, queue them, and run them with workers on one or more machines."""
