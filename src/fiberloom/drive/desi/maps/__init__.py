"""What images teach of the gears of each unit: maps, how they are kept, and the air, which is no part."""
