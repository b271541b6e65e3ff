"""Converts scenes of other programs to configurations."""
