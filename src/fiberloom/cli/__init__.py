"""The command line: one file a command. Each parses, calls, prints."""

from fiberloom.cli.app import main

__all__ = ["main"]
