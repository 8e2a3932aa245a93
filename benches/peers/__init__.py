"""Simplifiers of other tools, called as their users call them."""
