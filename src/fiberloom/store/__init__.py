"""The record of what was done and measured: SQLite by default, PostgreSQL by URL."""

from typing import TYPE_CHECKING

from fiberloom.lazy import on_use

if TYPE_CHECKING:
    from fiberloom.store.database import Store
    from fiberloom.store.run import Run, RunInfo

__all__ = ["Run", "RunInfo", "Store"]

__getattr__ = on_use(__name__)
