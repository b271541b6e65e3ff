"""A run's folder: how it is written whole, what it must hold, and how it is read again."""
