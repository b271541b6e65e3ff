"""A differentiable shadow-mapping research toolkit.

Its subpackages, each with its public names on one page:

- `geometry`: meshes, cameras, lights. `raster`: which face each pixel sees. `shadow`: maps, biases, compares, filters.
- `shading`: lit images. `fit`: settings by gradient. `reference`: traced truth. `metrics`: errors of shadows.
- `io`: mesh and image files. `config`: YAML configurations. `study`: runs that leave a folder.

A subpackage is loaded, and JAX with it, on first use. Importing the package changes nothing global. `setup()`, called
before JAX makes its first array, sets the process up for fast work. It calls these, which can also be called alone:

- `use_all_cores()` lets XLA run loops on all cores.
- `keep_freed_memory()` spares large arrays fresh pages.
- `collect_rarely()` spares imports and traces the garbage collector.
- `io.keep_compiled_programs()` keeps what JAX compiles for the next process.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._memory import collect_rarely, keep_freed_memory
from ._setup import setup
from ._xla import use_all_cores

if TYPE_CHECKING:
    from . import config, fit, geometry, io, metrics, raster, reference, shading, shadow, study

__version__: str

_SUBPACKAGES = ("config", "fit", "geometry", "io", "metrics", "raster", "reference", "shading", "shadow", "study")

__all__ = [
    "__version__",
    "collect_rarely",
    "config",
    "fit",
    "geometry",
    "io",
    "keep_freed_memory",
    "metrics",
    "raster",
    "reference",
    "setup",
    "shading",
    "shadow",
    "study",
    "use_all_cores",
]


def __getattr__(name: str) -> Any:
    if name in _SUBPACKAGES:
        return import_module(f".{name}", __name__)
    if name == "__version__":
        # Takes ten times as long to load as all the rest.
        from importlib.metadata import version

        return version("diffshadow")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
