"""Modifications of a scan after reading: up direction, scale, masks, adjusted cameras."""
