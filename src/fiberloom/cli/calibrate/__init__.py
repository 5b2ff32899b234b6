"""`fiberloom calibrate ...` and `acceptance`: what is particular to each positioner."""
