"""Mutants made and tried."""
