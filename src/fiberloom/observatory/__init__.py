"""One array in the control system of an observatory: what it sees and may ask, by OPC UA and by EPICS."""
