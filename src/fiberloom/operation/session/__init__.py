"""A session with an array: which state it is in, which process moves it, and the commands of an operator."""
