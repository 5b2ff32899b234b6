"""Figures and tables of what was done: nothing here decides anything."""
