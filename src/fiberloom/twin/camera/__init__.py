"""Cameras that look at the twin."""
