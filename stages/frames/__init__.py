"""Helpers for frames that several stages share: posed depth, colour lookup, features."""
