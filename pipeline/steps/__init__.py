"""Stages of the pipeline, one per file: parameters, inputs, artifact and code."""
