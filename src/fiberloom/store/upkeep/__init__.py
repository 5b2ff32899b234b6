"""Care of stores: older ones brought up to date, checked, copied."""
