"""Sweeps: many runs from one file, their workers, tables and report."""
