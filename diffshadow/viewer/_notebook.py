"""The page beside a notebook or a script: served from a thread of its own."""

import asyncio
import html
import json
import os
import tempfile
import threading
from pathlib import Path
from typing import Any

from rich.console import Console

from .. import io, study
from .._checks import check_instance
from ..config import Config, load_config, settings_file
from ..fit import PoseProblem, TechniqueProblem
from ..geometry import Scene
from ._server import Server
from ._state import State

_HEIGHT = 640


class OpenPage:
    """A page that is open. A notebook shows it where this is the last value of a cell.

    - `address`: of the page, for any browser of this machine.
    """

    def __init__(self, config: Config, name: str, port: int):
        self._loop = asyncio.new_event_loop()
        made: Any = asyncio.run_coroutine_threadsafe(_started(config, name, port), self._loop)
        threading.Thread(target=self._loop.run_forever, daemon=True, name="page").start()
        self._server: Server = made.result()
        self.address = self._server.address

    @property
    def values(self) -> dict[str, float]:
        """The numbers that were changed on the page, by the dotted keys that set them."""
        return dict(self._state.numbers)

    @property
    def config(self) -> Config:
        """The configuration as the page was left: a render of it draws the same."""
        viewer, state = self._server.viewer, self._state
        # In the thread that draws, like all that a viewer does.
        return self._server.drawing.submit(lambda: viewer.subject(state).saved(state)).result()

    def close(self) -> None:
        """Ends the page. Its values stay."""
        self._loop.call_soon_threadsafe(self._server.stop)

    @property
    def _state(self) -> State:
        return self._server.last or State()

    def __repr__(self) -> str:
        return f"a page at {self.address}"

    def _repr_html_(self) -> str:
        address = html.escape(self.address)
        return f'<iframe src="{address}" width="100%" height="{_HEIGHT}" allow="clipboard-write"></iframe>'


def view(what: Any, *overrides: str, port: int = 0) -> OpenPage:
    """Shows a scene in a page, on which its settings can be dragged.

    **Arguments:**

    - `what`: a `Config`; the path of a configuration, a mesh or a run's folder; a `Scene`; or a problem that has one,
        such as a `TechniqueProblem`. Of scenes and problems, the page shows meshes, camera and lights, with a
        configuration's default technique.
    - `overrides`: strings such as `"filter.radius=3"` that replace values of the configuration.
    - `port`: to listen on, on this machine only; 0 is any free one.

    **Returns** the page, whose `values` are the numbers that were changed on it.

    **Raises** `ConfigError` for a mistake in the configuration, `TypeError` for other objects, and `ValueError` for a
    problem without a scene, or a port that cannot be used.
    """
    if isinstance(what, TechniqueProblem | PoseProblem):
        what = what.scene
        if what is None:
            raise ValueError("the problem has no scene; expected one with a scene, as TechniqueProblem.of makes it")
    if isinstance(what, Scene):
        return OpenPage(_config_of(what, overrides), "scene", port)
    if isinstance(what, str | os.PathLike):
        file = settings_file(what).path if Path(what).is_dir() else Path(what)
        return OpenPage(load_config(file, overrides), str(what), port)
    check_instance("what to view", what, Config, "a configuration, its path, or a scene")
    if overrides:
        raise ValueError("overrides are given with a Config; expected a path with them: give them to load_config")
    return OpenPage(what, what.name, port)


def _config_of(scene: Scene, overrides: tuple[str, ...]) -> Config:
    """A configuration of `scene`, read from files that are removed with the process."""
    _FOLDERS.append(tempfile.TemporaryDirectory(prefix="diffshadow-"))
    folder = Path(_FOLDERS[-1].name)
    io.write_gltf(folder / "scene.glb", scene)
    made, sections = [], []
    for i, light in enumerate(scene.lights):
        # An import has one light.
        name, quiet = f"light {i}", Console(quiet=True)
        made.append(
            study.import_scene(
                folder / "scene.glb", console=quiet, light=name, technique="shadow_map", output=folder / name
            )
        )
        found: Any = load_config(made[-1]).scene.light
        section = found.model_dump(mode="json", exclude_none=True)
        radius = light.pose().radius
        # An import leaves out the sizes of lights.
        sized = {} if radius is None else {"angular_radius" if light.is_directional else "radius": float(radius)}
        sections.append({**section, **sized})
    several = ["scene.light=null", f"scene.lights={json.dumps(sections)}"]
    lights = several if len(sections) > 1 else [f"scene.light={json.dumps(sections[0])}"]
    return load_config(made[0], [*lights, *overrides])


_FOLDERS: list[tempfile.TemporaryDirectory[str]] = []


async def _started(config: Config, name: str, port: int) -> Server:
    server = Server(config, name)
    server.start(port)
    return server
