"""What is wrong with an array, found without moving anything."""
