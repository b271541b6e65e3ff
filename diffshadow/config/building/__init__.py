"""Builds modules from a configuration. In this subpackage, only this folder imports JAX."""
