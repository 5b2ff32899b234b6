"""The twin on CAN@net TCP ports, in real time."""
