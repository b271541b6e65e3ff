"""From files and overrides to configurations, and back to text."""
