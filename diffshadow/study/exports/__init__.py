"""Techniques for renderers of one's own."""
