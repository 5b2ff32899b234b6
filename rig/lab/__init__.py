"""The firmware on its targets: builds the rigs, runs scenarios on them, measures what they cost."""
