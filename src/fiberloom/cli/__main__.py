"""`python -m fiberloom.cli`."""

from fiberloom.cli.app import main

main()
