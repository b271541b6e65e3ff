"""Figures, tables and pages of stored runs."""
