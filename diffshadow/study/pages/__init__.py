"""Figures, tables and pages of what runs stored."""
