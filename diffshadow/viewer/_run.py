"""Runs the page until Ctrl-C."""

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
    """Shows `config`, or what it gives, in a page until Ctrl-C. The address is printed at once; what is slow follows,
    and the page says what that is.

    **Arguments:**

    - `name`: what the configuration was given as, for commands that can be pasted.
    - `port`: to listen on; 0 is any free one.
    - `browser`: whether to open the page in a browser.
    - `start`: called before anything is computed, in another thread.

    **Raises** `ValueError` for a port that cannot be used; and for a configuration that cannot be drawn, once the page
    has shown why.
    """

    def started(server: Server) -> None:
        console.print(server.address, soft_wrap=True)
        console.print("Ctrl-C ends it")
        if browser:
            webbrowser.open(server.address)

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(serve(config, name, port, listening=started, start=start))
