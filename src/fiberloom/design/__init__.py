"""Design rules of alpha-beta positioners: what arms, gear and spring mean before metal is cut."""
