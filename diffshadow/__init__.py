"""A differentiable shadow-mapping research toolkit.

Its subpackages, each with its public names on one page:

- `geometry`: meshes, cameras, lights. `raster`: visible faces. `shadow`: maps, biases, compares, filters.
- `shading`: lit images. `fit`: gradient fits of settings. `reference`: ray-traced references. `metrics`: errors of
  shadows.
- `io`: mesh and image files. `config`: YAML configurations. `study`: runs that write a folder.

A subpackage loads on first use, together with JAX. Importing the package changes no global state. `setup()` prepares
the process for fast work. Call it before JAX makes its first array. It calls these functions, which can also be called
alone:

- `use_all_cores()` lets XLA run loops on all cores.
- `keep_freed_memory()` reuses freed memory for large arrays.
- `limit_programs()` drops compiled programs in a long process before there are too many.
- `collect_rarely()` runs Python's garbage collector less often.
- `io.keep_compiled_programs()` keeps compiled programs for the next process.

`view(scene)` shows a scene in a page where you can drag its settings.

!!! Example

    The examples of all pages use these names.

    ```python
    import jax.numpy as jnp
    import numpy as np
    import optimistix
    from diffshadow import config, fit, geometry, io, metrics, raster, reference, shading, shadow

    meshes = [geometry.library_mesh("torus"), geometry.library_mesh("plane", size=4.0)]
    camera = geometry.PinholeCamera((1.6, 2.0, 2.0), (0.0, 0.3, 0.0), fov_y=40, near=0.1, far=10, resolution=(32, 32))
    light = geometry.DirectionalLight.around((0.5, -1.0, -0.3), geometry.merge(meshes).vertices, angular_radius=1.0)
    scene = geometry.Scene(meshes, camera, light)
    technique = shadow.ShadowMapping(shadow.Bilinear(), shadow.Bias(constant=1.0), map=shadow.MapSettings((64, 64)))
    state = technique.prepare(scene)
    surface = raster.draw_surface(scene.mesh, camera)
    visibility = technique.visibility(state, surface)
    truth = reference.trace_visibility(scene, samples=4)
    ```
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if sys.version_info < (3, 12):  # noqa: UP036
    # Checked before the import of modules that an older Python cannot parse. Installers check the version, but a copied
    # folder has no installer.
    raise ImportError(
        f"diffshadow needs Python 3.12 or newer, and this is {sys.version.split()[0]}; "
        "make an environment with a newer one, such as: python3.12 -m venv .venv"
    )

from ._memory import collect_rarely, keep_freed_memory, limit_programs
from ._setup import setup
from ._xla import use_all_cores

if TYPE_CHECKING:
    from . import config, fit, geometry, io, metrics, raster, reference, shading, shadow, study
    from .viewer import view

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
    "limit_programs",
    "metrics",
    "raster",
    "reference",
    "setup",
    "shading",
    "shadow",
    "study",
    "use_all_cores",
    "view",
]


def __getattr__(name: str) -> Any:
    if name in _SUBPACKAGES:
        return import_module(f".{name}", __name__)
    if name == "view":
        return import_module(".viewer", __name__).view
    if name == "__version__":
        # Takes ten times as long to load as everything else.
        from importlib.metadata import version

        return version("diffshadow")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
