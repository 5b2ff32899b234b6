"""A plan as a film: the arms of all positioners, and a clock."""
