"""The error budget: what a fibre is off after the blind move and after corrections, term by term."""
