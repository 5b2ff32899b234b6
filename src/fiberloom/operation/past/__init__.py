"""What a run leaves in its store beside measurements, and its result files made anew of all that."""
