"""Advice: a sweep of fits over techniques, their times, and what follows from both."""
