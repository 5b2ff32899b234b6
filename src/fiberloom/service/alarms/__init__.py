"""Alarms: raised, latched, sent to people outside."""
