"""Commands on past runs."""
