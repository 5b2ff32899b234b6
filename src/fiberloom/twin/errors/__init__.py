"""What a real array has wrong and its host does not know: sizes, and what they do."""
