"""`fiberloom calibrate ...` and `acceptance`: the properties of each positioner."""
