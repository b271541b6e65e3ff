"""The page of a notebook or a script, served from its own thread."""

import asyncio
import atexit
import contextlib
import html
import json
import os
import tempfile
import threading
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Any

from rich.console import Console

from .. import io, study
from .._checks import check_instance
from ..config import Config, load_config, settings_file
from ..fit import PoseProblem, TechniqueProblem
from ..geometry import Scene
from ._server import Server, serve
from ._state import State

_HEIGHT = 640


class OpenPage:
    """An open page. A notebook shows it if it is the last value of a cell.

    It stays open until `close`, the end of its `with` statement, or the end of Python.

    - `address`: the page's address, for any browser on this machine.
    """

    def __init__(self, config: Config, name: str, port: int, files: contextlib.ExitStack):
        started: Future[Server] = Future()
        self._thread = threading.Thread(target=_serve, args=(config, name, port, started), daemon=True, name="page")
        self._thread.start()
        self._server: Server | None = started.result()
        self.address = self._server.address
        # Removed when the page is closed.
        self._files = files.pop_all()
        # Still available after the page is closed.
        self._last = State()
        self._left: Future[Config] | None = None
        self._closing = threading.Lock()
        atexit.register(self.close)

    @property
    def values(self) -> dict[str, float]:
        """The numbers that were changed on the page, by dotted key."""
        return dict(self._state.numbers)

    @property
    def config(self) -> Config:
        """The configuration with the page's last settings. A render of it draws the page's picture. For a `Scene`, it
        refers to files that are removed when the page is closed."""
        return (self._left or self._read(self._server)).result()

    def close(self) -> None:
        """Closes the page and frees its memory. Its `values` and `config` remain.

        Waits until drawing, tracing and fitting have stopped after their current step.
        """
        with self._closing:
            server = self._server
            if server is None:
                return
            self._last = self._state
            # JAX cannot compute anything new while Python exits.
            with contextlib.suppress(RuntimeError):
                self._left = self._read(server)
                wait([self._left])
            with contextlib.suppress(RuntimeError):
                server.loop.call_soon_threadsafe(server.ended.set)
            self._thread.join()
            self._files.close()
            self._server = None
        atexit.unregister(self.close)

    def __enter__(self) -> "OpenPage":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _state(self) -> State:
        return self._last if self._server is None else self._server.last or self._last

    def _read(self, server: Any) -> Future[Config]:
        viewer, state = server.viewer, self._state
        # Called in the thread that draws, like all methods of the viewer.
        return server.drawing.submit(lambda: viewer.subject(state).saved(state))

    def __repr__(self) -> str:
        return f"a {'closed ' if self._server is None else ''}page at {self.address}"

    def _repr_html_(self) -> str:
        if self._server is None:
            return repr(self)
        address = html.escape(self.address)
        return f'<iframe src="{address}" width="100%" height="{_HEIGHT}" allow="clipboard-write"></iframe>'


def view(what: Any, *overrides: str, port: int = 0) -> OpenPage:
    """Shows a scene in a page where you can drag its settings.

    **Arguments:**

    - `what`: a `Config`; the path of a configuration, a mesh or a run's folder; a `Scene`; or a problem with a scene,
      such as a `TechniqueProblem`. A scene or a problem is shown with its meshes, camera and lights, and the default
      technique.
    - `overrides`: strings such as `"filter.radius=3"` that replace values of the configuration.
    - `port`: the port, open to this machine only; 0 chooses a free one.

    **Returns** the page, whose `values` are the numbers that were changed on it. `close` frees its memory.

    **Raises** `ConfigError` for an invalid configuration, `TypeError` for other objects, and `ValueError` for a problem
    without a scene or for a port that cannot be used.
    """
    if isinstance(what, TechniqueProblem | PoseProblem):
        what = what.scene
        if what is None:
            raise ValueError("the problem has no scene; expected one with a scene, as TechniqueProblem.of makes it")
    with contextlib.ExitStack() as files:
        if isinstance(what, Scene):
            folder = files.enter_context(tempfile.TemporaryDirectory(prefix="diffshadow-"))
            return OpenPage(_config_of(what, overrides, Path(folder)), "scene", port, files)
        if isinstance(what, str | os.PathLike):
            file = settings_file(what).path if Path(what).is_dir() else Path(what)
            return OpenPage(load_config(file, overrides), str(what), port, files)
        check_instance("what to view", what, Config, "a configuration, its path, or a scene")
        if overrides:
            raise ValueError("overrides are given with a Config; expected a path with them: give them to load_config")
        return OpenPage(what, what.name, port, files)


def _config_of(scene: Scene, overrides: tuple[str, ...], folder: Path) -> Config:
    """A configuration of `scene`. Writes its files into `folder`."""
    io.write_gltf(folder / "scene.glb", scene)
    made, sections = [], []
    for i, light in enumerate(scene.lights):
        # An imported file has one light.
        name, quiet = f"light {i}", Console(quiet=True)
        made.append(
            study.import_scene(
                folder / "scene.glb", console=quiet, light=name, technique="shadow_map", output=folder / name
            )
        )
        found: Any = load_config(made[-1]).scene.light
        section = found.model_dump(mode="json", exclude_none=True)
        radius = light.pose().radius
        # An imported file does not have the sizes of lights.
        sized = {} if radius is None else {"angular_radius" if light.is_directional else "radius": float(radius)}
        sections.append({**section, **sized})
    several = ["scene.light=null", f"scene.lights={json.dumps(sections)}"]
    lights = several if len(sections) > 1 else [f"scene.light={json.dumps(sections[0])}"]
    return load_config(made[0], [*lights, *overrides])


def _serve(config: Config, name: str, port: int, started: Future[Server]) -> None:
    """Starts a server, and serves until the server is `ended` and all its work has stopped."""
    try:
        asyncio.run(serve(config, name, port, prepared=started.set_result))
    except Exception as error:
        if started.done():
            raise
        started.set_exception(error)
    else:
        started.result().join()
