"""A night that is served: shown while it goes on, and what people ask of it."""
