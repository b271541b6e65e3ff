"""Paths in a configuration."""

import os
from pathlib import Path

from .._errors import show
from ._section import fault


def path_of(text: str) -> Path:
    """The path `text`, with a leading `~` expanded to the current user's home folder.

    **Raises** `PydanticCustomError`, a `ValueError`, if `text` names another user's home folder or holds U+0000.
    """
    if "\0" in text:
        raise fault(f"is {show(text)}, which holds the character U+0000", "a path", "remove it")
    first, _, _ = text.partition("/")
    if first == "~":
        home = os.path.expanduser("~")
        if home == "~":
            message = f"is {show(text)}, and the current user has no home folder"
            raise fault(message, "a path without ~", "write the folder out, or set the variable HOME")
        return Path(home + text[1:])
    if first.startswith("~"):
        message = f"is {show(text)}, which begins with the home folder of another user"
        mend = f"write that folder out, or ./{first} for a folder of that name"
        raise fault(message, "a path, in which ~/ is the current user's home folder", mend)
    return Path(text)
