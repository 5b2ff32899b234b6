"""Optics of telescopes: from directions in the field to millimetres, and back."""
