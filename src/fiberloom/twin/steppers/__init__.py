"""Steppers of the twin (MEGARA, MOONS, LAMOST): their array, and the controllers in front of it."""
