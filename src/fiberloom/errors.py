"""Errors that are meant for the user."""


class InputError(Exception):
    """Bad input: one line that says what is wrong, where, and what to do."""
