"""The steps from one version of the tables to the next, one line, named by the version they lead to."""
