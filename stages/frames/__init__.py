"""Helpers for frames that several stages share: posed depth, colour, projection, features, sampling."""
