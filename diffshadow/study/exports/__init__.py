"""Exports techniques to other renderers."""
