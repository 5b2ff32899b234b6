"""Figures 5, 18, 19, 20 and Table 1: cameras and whole focal planes."""
