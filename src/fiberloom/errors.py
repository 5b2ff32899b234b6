"""Errors that are meant to be read by the person who typed the command."""

MOST_LETTERS = 600
"""Of a complaint: a cell of a file may be endless."""


def one_line(error: object, most: int = 200) -> str:
    """What an error says, in one line of at most `most` letters and a few."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 2 :]}"


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

    def __init__(self, text: str, most: int = MOST_LETTERS) -> None:
        super().__init__(text if len(text) <= most and "\n" not in text else one_line(text, most))


class StoppedError(RuntimeError):
    """Stopped by the operator or by another process, or because that has taken the array; nothing moves."""
