"""Builds modules from a configuration. No other folder of this subpackage imports JAX."""
