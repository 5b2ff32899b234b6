"""What stands behind each command: puts the rooms together. The one place that chooses a twin."""
