"""A series of exposures on one field."""
