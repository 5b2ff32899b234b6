"""Maps and arms that learn from every measured move."""
