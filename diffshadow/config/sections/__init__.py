"""Sections of a configuration: their keys, and the numbers among them that can be fitted."""
