"""Thermal and electrical care: what motors and supply may be asked for."""
