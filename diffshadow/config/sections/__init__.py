"""Sections of a configuration: their keys, and which of their numbers can be fitted."""
