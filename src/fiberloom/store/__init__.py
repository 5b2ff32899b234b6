"""The record of what was done and measured: SQLite by default, PostgreSQL by URL."""

from fiberloom.store.database import Store
from fiberloom.store.run import Run, RunInfo

__all__ = ["Run", "RunInfo", "Store"]
