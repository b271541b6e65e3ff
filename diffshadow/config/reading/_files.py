"""The files that a run reads."""

import functools
import importlib.metadata
import sys
from collections.abc import Iterator
from pathlib import Path

from ..whole._schema import Config
from ._plugins import COLON


def input_files(config: Config) -> list[Path]:
    """The absolute paths of all meshes and images that `config` and its views read."""
    return list(dict.fromkeys(_files(config)))


def _files(config: Config) -> Iterator[Path]:
    from ...io import files_of_mesh

    for mesh in config.scene.meshes:
        if mesh.builtin is None:
            yield from files_of_mesh(mesh.path)
        if mesh.texture is not None:
            yield Path(mesh.texture)
    yield from (Path(file) for key in ("path", "mask") if (file := getattr(config.reference, key, None)))
    for view in (*config.views, *config.validation):
        yield from _files(view.config)


@functools.cache
def _installed() -> frozenset[str]:
    return frozenset(importlib.metadata.packages_distributions())


def user_modules(config: Config) -> list[Path]:
    """The files of modules, and the folders of packages, whose classes `config` names and that are not installed."""
    words = [getattr(section, "type", None) for section in (config.technique, config.filter, config.fit.loss)]
    names = {word.partition(COLON)[0].split(".")[0] for word in words if isinstance(word, str) and COLON in word}
    found = []
    # Looking through what is installed takes a second.
    for name in sorted(names - _installed()) if names else ():
        file = Path(getattr(sys.modules[name], "__file__", None) or "")
        found.append(file.parent if file.name == "__init__.py" else file)
    return found
