"""Centres, arms and zeros of positioners where they are mounted."""
