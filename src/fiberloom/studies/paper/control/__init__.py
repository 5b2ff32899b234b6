"""Figures 16 and 17, Equation 22: tracking, repeatability, collisions."""
