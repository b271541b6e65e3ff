"""Counts in words. This module imports nothing, because the command line reports mistakes before it loads JAX."""

# Text after a noun begins with one of these.
_AFTER = (" of ", " that ", " without ")


def plural(noun: str) -> str:
    """The plural of a regular noun. Text after the noun, such as " of 3 kinds", does not change."""
    end = min((noun.index(word) for word in _AFTER if word in noun), default=len(noun))
    first, rest = noun[:end], noun[end:]
    if first.endswith("y") and first[-2:-1] not in "aeiou":
        return f"{first[:-1]}ies{rest}"
    return f"{first}{'es' if first.endswith(('sh', 'ch', 's', 'x')) else 's'}{rest}"


def counted(count: int, noun: str) -> str:
    """A count with its noun, such as "1 entry" or "1,024 entries"."""
    return f"{count:,} {noun if count == 1 else plural(noun)}"
