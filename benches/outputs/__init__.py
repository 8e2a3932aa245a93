"""Jobs and comparisons of same_outputs.py.

They use no internal names of a checkout.
"""
