"""Batch processing of many scans.

Scans are found in a folder, queued, and run by workers on one or more machines.
"""
