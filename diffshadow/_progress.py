"""Where long work says how far it is. Nothing here prints: `diffshadow.setup` installs what does."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

Update = Callable[[str, float | None], None]
"""Called with a detail, such as the number of a step, and the fraction done (none if the fraction is not known)."""
Display = Callable[[str], AbstractContextManager[Update | None]]
"""Shows that work with a name is under way, while its context lasts; none where nobody would see it."""

_installed: list[Display] = []


def show_with(display: Display | None) -> None:
    """Makes `display` show all long work from here on; with none, nothing is shown."""
    _installed[:] = [] if display is None else [display]


@contextmanager
def showing(name: str, *, unless: bool = False) -> Iterator[Update | None]:
    """Shows the work inside by its `name`.

    **Arguments:**

    - `unless`: whether the caller learns the state in another way, so that nothing is shown.

    **Yields** a function to call with the state of the work; none if nothing is shown.
    """
    if unless or not _installed:
        yield None
        return
    with _installed[0](name) as update:
        yield update
