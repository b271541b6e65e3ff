"""Sections of a configuration: what each may hold, and which of its numbers a fit may change."""
