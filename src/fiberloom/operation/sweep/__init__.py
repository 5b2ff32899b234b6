"""The sweep of transmissions where positioners are mounted: all turn together, among their neighbours."""
