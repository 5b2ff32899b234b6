"""From what a bench found to the parameters of a positioner's firmware."""
