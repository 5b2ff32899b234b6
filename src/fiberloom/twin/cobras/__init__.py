"""Cobras of the twin (PFS): their array, and the boards that command it."""
