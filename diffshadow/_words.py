"""Numbers of things in words. Nothing is imported, since the command line names mistakes before it loads JAX."""


def plural(noun: str) -> str:
    """A noun of regular form in the plural; what follows " of " stays."""
    first, of, rest = noun.partition(" of ")
    if first.endswith("y") and first[-2:-1] not in "aeiou":
        return f"{first[:-1]}ies{of}{rest}"
    return f"{first}{'es' if first.endswith(('sh', 'ch', 's', 'x')) else 's'}{of}{rest}"


def counted(count: int, noun: str) -> str:
    """A number of things in words, such as "1 entry" or "1,024 entries"."""
    return f"{count:,} {noun if count == 1 else plural(noun)}"
