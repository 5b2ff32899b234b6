"""Which motors the twin's axes have, and what they take from the supply."""
