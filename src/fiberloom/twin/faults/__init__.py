"""What can go wrong on the twin, and when."""
