"""A configuration that has not been checked."""

from pathlib import Path
from typing import Any, NamedTuple

from .._errors import Mistake, Origin


class Draft(NamedTuple):
    """An unchecked configuration, and the mistakes found so far.

    - `folder`: the folder that relative paths in the file start from.
    """

    data: dict[str, Any]
    origin: Origin
    folder: Path
    mistakes: list[Mistake]
