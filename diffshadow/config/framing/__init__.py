"""Cameras, lights and grounds that a configuration leaves to the program."""
