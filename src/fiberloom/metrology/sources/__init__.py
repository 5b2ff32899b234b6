"""Cameras outside of this process: by Alpaca, by a folder of files, by INDI, by GenICam."""
