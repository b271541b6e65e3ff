"""Single runs: renders and fits, from a configuration to a folder."""
