"""Instruments as TOML files."""
