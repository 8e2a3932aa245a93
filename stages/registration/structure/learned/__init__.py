"""Learned features of photos, with the weights of an installed package."""
