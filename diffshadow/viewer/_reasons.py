"""The words for errors on pages."""

from ..config import ConfigError


def reason_of(error: Exception) -> str:
    """The words for an `error` on a page."""
    if isinstance(error, ConfigError):
        return "; ".join(": ".join(filter(None, (each.key, each.message))) for each in error.mistakes)
    return str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
