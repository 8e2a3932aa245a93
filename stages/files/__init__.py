"""Files from outside, read without trusting them, and files that are written whole or not at all."""
