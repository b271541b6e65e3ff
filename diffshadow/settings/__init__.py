"""Settings: each default, limit, unit, choice and meaning, defined once.

A class of settings describes the settings of one technique, filter, light or solver. Its annotations are types with
marks, and its values are the defaults:

    class Tent(Filter):
        radius: Annotated[float, Limits(0, 128), Unit("texels"), Fitted(), "half the tent's width, in texels"] = 2.5

A module names its class as `settings`. Its defaults come from there, and `_checks.check_settings` checks its fields. A
section of a configuration inherits from the same class. Only rules between keys are written by hand.

Nothing here needs JAX or pydantic, so that the command can refuse a configuration before either is loaded.
"""

from ._settings import MISSING as MISSING
from ._settings import At, Fitted, Limits, LongerThan, Setting, Settings, Unit
from ._settings import Form as Form
from ._settings import InputFile as InputFile
from ._settings import bare as bare
from ._settings import is_union as is_union

__all__ = [
    "At",
    "Fitted",
    "Limits",
    "LongerThan",
    "Setting",
    "Settings",
    "Unit",
]


def __dir__() -> list[str]:
    return __all__
