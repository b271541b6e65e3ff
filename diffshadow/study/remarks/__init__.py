"""Remarks of runs: faults of the input, causes, and advice."""
