"""`fiberloom design`: what a choice of arms, pitch, gear, spring means before metal is cut."""
