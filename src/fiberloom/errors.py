"""Errors that are meant to be read by the person who typed the command."""


class InputError(ValueError):
    """Bad input: one line that says what is wrong, where, and what to do."""
