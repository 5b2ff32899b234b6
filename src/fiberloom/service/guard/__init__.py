"""Who may do what: tokens and roles, where requests may come from, how large they may be."""
