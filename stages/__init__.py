"""Stages of the scan pipeline, as plain functions on in-memory data."""
