"""Beartype's checks, each made at the first call of its function: imports define thousands, and few are called."""

from beartype import beartype


def checked(function):
    """As `beartype.beartype`, for `jaxtyping.install_import_hook`."""
    made = None

    def call(*arguments, **options):
        nonlocal made
        made = made or beartype(function)
        return made(*arguments, **options)

    return call
