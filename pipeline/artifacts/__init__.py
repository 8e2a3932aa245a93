"""Artifacts shared by several stages.

An artifact of a single stage is defined with that stage.
"""
