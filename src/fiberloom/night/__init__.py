"""A night: a queue of fields, chosen one by one, positioned, exposed, recorded; resumed after a crash."""
