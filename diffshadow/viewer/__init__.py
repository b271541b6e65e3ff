"""A page that shows a configuration, and redraws it while its settings are dragged."""

from ._animate import Change as Change
from ._animate import animate as animate
from ._animate import animate_run as animate_run
from ._notebook import OpenPage as OpenPage
from ._notebook import view as view
from ._run import run as run
from ._state import Look as Look
from ._state import State as State
from ._viewer import Viewer as Viewer

__all__: list[str] = []
