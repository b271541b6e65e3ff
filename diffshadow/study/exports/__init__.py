"""Techniques for your own renderer."""
