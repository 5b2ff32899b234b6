"""`fiberloom sky`: from RA and Dec to mm, and back."""
