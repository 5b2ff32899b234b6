"""Which positioners are fit, by what evidence, and what to do."""
