"""Commands to an array that outlives them: one file a command, and the options that they share."""
