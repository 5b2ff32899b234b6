"""Figures 10 to 14: what a bench finds of a drivetrain."""
