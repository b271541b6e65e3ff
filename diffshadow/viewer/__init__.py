"""A page that shows a configuration and redraws it while you drag its settings."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

# # These modules do not load JAX, so the server can answer before JAX is loaded.
from ._run import run as run
from ._state import Look as Look
from ._state import State as State

__all__: list[str] = []

if TYPE_CHECKING:
    from ._animate import Change as Change
    from ._animate import animate as animate
    from ._animate import animate_run as animate_run
    from ._notebook import OpenPage as OpenPage
    from ._notebook import view as view
    from ._viewer import Viewer as Viewer

_ON_USE = {
    **dict.fromkeys(("Change", "animate", "animate_run"), "._animate"),
    **dict.fromkeys(("OpenPage", "view"), "._notebook"),
    "Viewer": "._viewer",
}


def __getattr__(name: str) -> Any:
    if name in _ON_USE:
        return getattr(import_module(_ON_USE[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
