"""What keeps arms apart when something is not as believed: the begin check, and how to stop."""
