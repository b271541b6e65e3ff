"""Progress of long work. This module prints nothing; `diffshadow.setup` installs the display."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

Update = Callable[[str, float | None], None]
"""Called with a detail, such as the number of a step, and the finished fraction (`None` if unknown)."""
Display = Callable[[str], AbstractContextManager[Update | None]]
"""Shows named work while its context lasts. `None` if nobody would see it."""

_installed: list[Display] = []


def show_with(display: Display | None) -> None:
    """Makes `display` show all long work from now on. With `None`, nothing is shown."""
    _installed[:] = [] if display is None else [display]


@contextmanager
def showing(name: str, *, unless: bool = False) -> Iterator[Update | None]:
    """Shows the work inside under its `name`.

    **Arguments:**

    - `unless`: whether the caller already reports progress, so that nothing is shown.

    **Yields** a function to call with the state of the work, or `None` if nothing is shown.
    """
    if unless or not _installed:
        yield None
        return
    with _installed[0](name) as update:
        yield update
