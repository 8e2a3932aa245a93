"""Measurements and pictures of the stage `report`."""
