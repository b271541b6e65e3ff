"""Reads configurations from files and overrides, and writes them as text."""
