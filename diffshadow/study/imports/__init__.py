"""Turns scenes of other programs into configurations."""
