"""The camera of a served twin: Alpaca, a folder of files, INDI; in a process of its own."""
