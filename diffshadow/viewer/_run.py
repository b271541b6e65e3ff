"""Runs the page until Ctrl-C."""

import asyncio
import contextlib
import webbrowser

from rich.console import Console

from ..config import Config
from ._server import Server, serve


def run(config: Config, *, name: str, console: Console, port: int = 0, browser: bool = True) -> None:
    """Shows `config` in a page until Ctrl-C. The address is printed.

    **Arguments:**

    - `name`: what the configuration was given as, for commands that can be pasted.
    - `port`: to listen on; 0 is any free one.
    - `browser`: whether to open the page in a browser.

    **Raises** `ValueError` for a configuration that cannot be drawn, or a port that cannot be used.
    """

    def started(server: Server) -> None:
        console.print(server.address, soft_wrap=True)
        console.print("Ctrl-C ends it")
        if browser:
            webbrowser.open(server.address)

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(serve(config, name, port, started))
