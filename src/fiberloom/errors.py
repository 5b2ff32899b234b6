"""Errors that are meant to be read by the person who typed the command."""


class InputError(ValueError):
    """Bad input: one line that says what is wrong, where, and what to do.

    The command line prints the same line and ends with exit code 2.

    Examples
    --------
    >>> import fiberloom as fl
    >>> try:
    ...     fl.FocalPlane.of("sdssv", n=0)
    ... except fl.InputError as error:
    ...     error
    InputError('n_positioners = 0: must be at least 1')
    """


class StoppedError(RuntimeError):
    """Stopped by another process, or because another one has taken the array; all that moved is at rest."""
