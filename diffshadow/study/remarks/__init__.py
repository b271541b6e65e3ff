"""What runs say beside their figures: faults of what they were given, causes, and what to try."""
