"""Serves the page until Ctrl-C."""

import asyncio
import contextlib
import webbrowser
from collections.abc import Callable

from rich.console import Console

from ..config import Config
from ._server import Server, serve


def run(
    config: Config | Callable[[], Config],
    *,
    name: str,
    console: Console,
    port: int = 0,
    browser: bool = True,
    start: Callable[[], None] = lambda: None,
) -> None:
    """Shows a configuration in a page until Ctrl-C. The address is printed at once. Slow steps follow, and the page
    names each of them.

    **Arguments:**

    - `config`: the configuration, or a function that returns it.
    - `name`: the configuration's name on the command line, for commands that can be pasted.
    - `port`: the port; 0 chooses a free one.
    - `browser`: whether to open the page in a browser.
    - `start`: called before anything is computed, in another thread.

    **Raises** `ValueError` for a port that cannot be used. **Raises** the error of a configuration that cannot be
    drawn, after the page has shown it.
    """

    def started(server: Server) -> None:
        console.print(server.address, soft_wrap=True)
        console.print("Ctrl-C ends it")
        if browser:
            webbrowser.open(server.address)

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(serve(config, name, port, listening=started, start=start))
