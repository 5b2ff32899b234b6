"""Figures 21, 22, 25 and 26: a lifetime of wear."""
