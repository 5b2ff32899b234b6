"""What the service keeps of an array beside its runs: commands, alarms; and what it reads."""
