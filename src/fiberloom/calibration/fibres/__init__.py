"""Where the science fibres are on their arms, which no metrology camera sees: found with stars."""
