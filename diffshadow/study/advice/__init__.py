"""Advice: fits of several techniques, their times, and a recommendation."""
