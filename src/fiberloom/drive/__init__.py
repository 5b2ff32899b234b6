"""What an instrument's own motors and controllers make of a wanted way."""
