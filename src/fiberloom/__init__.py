"""fiberloom: the control stack for alpha-beta optical fibre positioners."""

__version__ = "0.1.0"
