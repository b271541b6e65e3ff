"""Configurations made of scenes of other programs."""
