"""Referencing: where each positioner is, once power has come on and no datum is on record."""
