"""Stages of the pipeline, one file each: parameters, inputs, result, code and texts of a stage."""
