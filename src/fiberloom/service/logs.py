"""A log file with one JSON object a line, which does not grow without end."""

from __future__ import annotations

import json
import logging
import logging.handlers
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fiberloom.errors import InputError

BYTES, FILES = 10 << 20, 5
"""Of one file, and of files that are kept."""
NAMES = ("fiberloom.service", "uvicorn.error")


class JsonLines(logging.Formatter):
    """One object a line: time, level, logger, text, and what else is known."""

    def format(self, record: logging.LogRecord) -> str:
        """The line of a record."""
        line: dict[str, Any] = {
            "utc": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "text": record.getMessage(),
        }
        if (content := getattr(record, "content", None)) is not None:
            line["content"] = content
        if record.exc_info:
            line["error"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def log_to(path: Path) -> logging.Handler:
    """Writes what the service and its server say to a file. InputError where it cannot be written."""
    try:
        handler = logging.handlers.RotatingFileHandler(path, maxBytes=BYTES, backupCount=FILES)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    handler.setFormatter(JsonLines())
    for name in NAMES:
        logging.getLogger(name).addHandler(handler)
    logging.getLogger("fiberloom.service").setLevel(logging.INFO)
    return handler


def end_log(handler: logging.Handler) -> None:
    """Closes the file."""
    for name in NAMES:
        logging.getLogger(name).removeHandler(handler)
    handler.close()


LOGGED = ("command", "stage", "plan", "event", "stopped", "array")
"""Kinds of events that are written; pictures and lists of states are not."""


def log_event(kind: str, content: dict[str, Any]) -> None:
    """Writes an event of the array: its `kind` and `content`."""
    if kind not in LOGGED:
        return
    short = {k: v for k, v in content.items() if k != "targets"}
    logging.getLogger("fiberloom.service").info(kind, extra={"content": short})
