"""Run folders: writing them atomically, the schema of their files, and reading them."""
