"""Tables that people write and programs read: CSV, ECSV, FITS."""

from fiberloom.tables.table_file import TableFile, read_ecsv, read_table, write_columns, write_ecsv

__all__ = ["TableFile", "read_ecsv", "read_table", "write_columns", "write_ecsv"]
