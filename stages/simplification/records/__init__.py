"""Collapses kept, so that every mesh on the way can be had again."""
