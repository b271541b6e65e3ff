"""From a configuration to the modules that do the work. Of this room, only this folder loads JAX."""
