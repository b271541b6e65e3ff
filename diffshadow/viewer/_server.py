"""Serves pages on this machine. Pictures are sent one at a time, and each page confirms its picture before the next is
sent."""

import asyncio
import contextlib
import json
import socket
import struct
import time
from collections.abc import Callable, Hashable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import tornado.web
import tornado.websocket
from pydantic import ValidationError
from tornado.httpserver import HTTPServer

from .._memory import give_back_freed_memory
from ..config import Config, printable
from ._reasons import reason_of
from ._state import Look, Message, State

if TYPE_CHECKING:
    from ._viewer import Viewer

HOST = "127.0.0.1"
# A picture is drawn at full size after this many seconds without a change.
_REST = 0.25
# A page says that its picture takes long after this many seconds.
_LONG = 0.7
# The limit of a message, in bytes. A longer message closes the connection without an answer.
_MAX_MESSAGE, _MOST_READ = 1 << 18, 1 << 26
_MOST_PORT = (1 << 16) - 1
# The limit of quoted text in an answer, in characters.
_SHORT = 80
_FILES = {"": "text/html", "page.css": "text/css", "page.js": "text/javascript"}
# Pages load nothing from other hosts, and other hosts' pages cannot frame them.
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src blob: data:; "
    "frame-ancestors 'self' http://localhost:* http://127.0.0.1:*; base-uri 'none'; form-action 'none'"
)


class Server:
    """The server of one configuration. Its methods are called in the thread of its event loop.

    The server can listen at once. Another thread calls `start`, loads JAX and builds the configuration; `stage` names
    its current step. The configuration may also be a function, which that thread calls.

    - `ended`: set this event to end `serve`.
    - `last`: the last settings that a page has shown, or `None`.
    - `drawn`: the structures that have a full picture, so drawing them compiles nothing.
    - `stage`: the work that precedes the first picture.
    """

    def __init__(self, config: Config | Callable[[], Config], name: str, start: Callable[[], None] = lambda: None):
        self.loop = asyncio.get_running_loop()
        self.ended = asyncio.Event()
        self.pages: set[Page] = set()
        # One thread draws for all pages. A second thread compiles, so a page never waits while another page compiles.
        self.drawing = ThreadPoolExecutor(1, thread_name_prefix="drawing")
        self.compiling = ThreadPoolExecutor(1, thread_name_prefix="compiling")
        self.last: State | None = None
        self.drawn: set[str] = set()
        self.stage = "loading JAX"
        self._make = lambda: self._viewer_of(config, name, start)
        self._made: Future[Viewer] = Future()
        self._http: HTTPServer | None = None
        self.address = ""

    def _viewer_of(self, config: Config | Callable[[], Config], name: str, start: Callable[[], None]) -> "Viewer":
        start()
        from ._viewer import Viewer

        self._in_loop(self._tell_stage)("reading meshes and building the technique")
        given = config if isinstance(config, Config) else config()
        viewer = Viewer(given, name, self._in_loop(self._traced), self._in_loop(self._fitted))
        self._in_loop(self._tell_stage)("drawing the first picture")
        return viewer

    @property
    def viewer(self) -> "Viewer":
        """The viewer. Waits until it is built, so only other threads may use this earlier.

        **Raises** the error of building it.
        """
        return self._made.result()

    @property
    def is_made(self) -> bool:
        """Whether the `viewer` is built."""
        return self._made.done() and not self._made.cancelled() and self._made.exception() is None

    async def prepared(self) -> None:
        """Waits until the `viewer` is built. **Raises** the error of building it, after all pages have received it."""
        try:
            await asyncio.wrap_future(self._made)
        except Exception as error:
            for page in self.pages:
                page.tell(error=reason_of(error))
            raise

    def start(self, port: int) -> None:
        """Listens on `port` (0 chooses a free one) and begins to build the `viewer`. **Raises** `ValueError` if the
        port is taken."""
        try:
            if not 0 <= port <= _MOST_PORT:
                raise OverflowError("there is no such port")
            bound = socket.create_server((HOST, port))
        except (OSError, OverflowError) as error:
            raise ValueError(
                f"--port is {port}, which cannot be used ({error}); expected a free port from 0 to {_MOST_PORT}, "
                "where 0 chooses any; choose another"
            ) from error
        settings: dict[str, Any] = {"server": self, "websocket_max_message_size": _MOST_READ}
        routes = [(r"/socket", Page), (r"/(page\.css|page\.js|)", File)]
        application = tornado.web.Application(routes, log_function=lambda handler: None, **settings)
        bound.setblocking(False)
        self._http = http = HTTPServer(application)
        http.add_socket(bound)
        self.address = f"http://{HOST}:{bound.getsockname()[1]}/"
        self._made = self.compiling.submit(self._make)

    def stop(self) -> None:
        """Closes all pages and stops listening. Drawing, tracing and fitting stop after their current step."""
        for page in [*self.pages]:
            page.leave()
        if self._http is not None:
            self._http.stop()
        for thread in (self.drawing, self.compiling):
            thread.shutdown(wait=False, cancel_futures=True)
        if self.is_made:
            self.viewer.close()

    async def hang_up(self) -> None:
        """Closes the connections that `stop` left open."""
        if self._http is not None:
            await self._http.close_all_connections()

    def join(self) -> None:
        """Waits until all work has ended after `stop`. Called in another thread, or after the loop has ended."""
        for thread in (self.drawing, self.compiling):
            thread.shutdown()
        if self.is_made:
            # A fit may have started in the meantime.
            self.viewer.close()
            self.viewer.join()

    def _in_loop(self, call: Callable[[Any], None]) -> Callable[[Any], None]:
        """A version of `call` that other threads can call."""

        def later(value: Any) -> None:
            # The loop may be closed already.
            with contextlib.suppress(RuntimeError):
                self.loop.call_soon_threadsafe(call, value)

        return later

    def _tell_stage(self, stage: str) -> None:
        self.stage = stage
        for page in self.pages:
            page.tell(note=f"{stage} …")

    def _traced(self, key: Hashable) -> None:
        for page in self.pages:
            page.traced(key)

    def _fitted(self, news: Mapping[str, Any]) -> None:
        for page in self.pages:
            page.tell(fit=news)


class File(tornado.web.RequestHandler):
    """The files of the page."""

    def prepare(self) -> None:
        check_host(self)

    def get(self, name: str) -> None:
        self.set_header("Content-Type", f"{_FILES[name]}; charset=utf-8")
        self.set_header("Content-Security-Policy", _POLICY)
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Cache-Control", "no-cache")
        self.finish((files(__package__) / (name or "page.html")).read_bytes())


class Page(tornado.websocket.WebSocketHandler):
    """One page: its settings, and the pictures that it has received."""

    def prepare(self) -> None:
        check_host(self)

    def open(self, *_: str, **__: str) -> None:
        self.server: Server = self.settings["server"]
        self.server.pages.add(self)
        self.look: Look | None = None
        self.since = 0.0
        # What the current look still needs: a picture at all, and a picture at full size or with a better reference.
        self.is_new = self.is_rough = False
        self.in_flight: int | None = None
        self.number = 0
        self.key: Hashable = None
        # The structure of the controls that the page has.
        self.built = ""
        self.tasks: set[asyncio.Future[None]] = set()
        if not self.server.drawn:
            self.tell(note=f"{self.server.stage} …")
        self.woken = asyncio.Event()
        self.pump = asyncio.ensure_future(self._pump())

    def leave(self) -> None:
        """Closes the connection at once."""
        connection: Any = self.ws_connection
        self.close()
        if connection is not None:
            # Not all clients answer.
            connection.stream.close()

    def on_close(self) -> None:
        self.server.pages.discard(self)
        self._rest()
        self.pump.cancel()

    def tell(self, **parts: Any) -> None:
        """Sends a message, unless the page is closed."""
        with contextlib.suppress(tornado.websocket.WebSocketClosedError):
            self.write_message(json.dumps(parts))

    def tell_that_it_takes_long(self) -> None:
        """Tells the page that the next picture is slow, because its programs are compiled first."""
        if self.server.drawn:
            self.tell(note="drawing this for the first time takes longer")

    def on_message(self, message: str | bytes) -> None:
        try:
            asked = _message_of(message)
        except ValueError as error:
            self.tell(error=str(error))
            return
        if asked.look is not None:
            if self.look is None or _truth_of(asked.look) != _truth_of(self.look):
                self._rest()
            self.look, self.since, self.is_new = asked.look, time.monotonic(), True
            self.server.last = asked.look.state
        if asked.shown is not None and asked.shown == self.in_flight:
            self.in_flight = None
        if asked.stop and self.server.is_made:
            self.server.viewer.fit.stop()
        if asked.save is not None:
            self._answer("saved", lambda viewer, state: viewer.save(state), asked.save)
        if asked.code is not None:
            self._answer("code", lambda viewer, look: viewer.code(look), asked.code)
        if asked.picture is not None:
            self._answer("picture", lambda viewer, look: viewer.png(look), asked.picture)
        if asked.fit is not None:
            self._answer("started", lambda viewer, state: viewer.start_fit(state), asked.fit)
        self.woken.set()

    def traced(self, key: Hashable) -> None:
        """Handles a better reference."""
        if key == self.key:
            self.is_rough = True
            self.woken.set()

    def _rest(self) -> None:
        """Stops tracing for this page."""
        if self.server.is_made:
            self.server.viewer.tracer.rest(self)

    def _answer(self, part: str, work: Callable[["Viewer", Any], Any], given: Any) -> None:
        async def answer() -> None:
            with self._errors():
                self.tell(**{part: await self._do(self.server.drawing, lambda: work(self.server.viewer, given))})

        # The loop keeps only weak references to tasks.
        task = asyncio.ensure_future(answer())
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    async def _do(self, thread: ThreadPoolExecutor, work: Callable[[], Any]) -> Any:
        return await self.server.loop.run_in_executor(thread, work)

    @contextlib.contextmanager
    def _errors(self) -> Any:
        """Shows an error on the page. The last picture stays."""
        try:
            yield
        except Exception as error:
            self.tell(error=reason_of(error))

    async def _pump(self) -> None:
        """Draws the newest look each time the page has shown the last picture: once immediately, and once more at
        rest."""
        while True:
            self.woken.clear()
            rest = self.since + _REST - time.monotonic()
            at_rest = rest <= 0
            if self.look is None or self.in_flight is not None or not (self.is_new or self.is_rough):
                await self.woken.wait()
            elif not self.is_new and not at_rest:
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self.woken.wait(), rest)
            else:
                with self._errors():
                    await self._draw(self.look, at_rest)

    async def _draw(self, look: Look, at_rest: bool) -> None:
        is_new, self.is_new, self.is_rough = self.is_new, False, False
        slow = self.server.loop.call_later(_LONG, self.tell_that_it_takes_long)
        try:
            built = look.state.model_copy(update={"numbers": {}, "camera": None, "fitted": None}).model_dump_json()
            thread = self.server.drawing if built in self.server.drawn else self.server.compiling
            if built != self.built:
                controls = await self._do(thread, lambda: self.server.viewer.controls(look.state))
                self.built = built
                self.tell(controls=controls)

            def draw() -> tuple[list[str], Any]:
                # All work of a picture happens in one visit to the thread, because each visit costs a wait.
                viewer = self.server.viewer
                return viewer.misfits(look.state) if is_new else [], viewer.show(look, at_rest=at_rest)

            wrong, shown = await self._do(thread, draw)
            if wrong:
                self.tell(error="; ".join(wrong))
            self.is_rough = not shown.about["is_full"] or self.is_rough
            if shown.about["is_full"]:
                self.server.drawn.add(built)
                viewer = self.server.viewer
                self.key = await self._do(thread, lambda: viewer.trace(look, self))
                # A better reference may have come before this page knew its key.
                known = viewer.tracer.reference(self.key)
                self.is_rough |= known is not None and known.samples != shown.about["rays"]
        finally:
            slow.cancel()
        self.number += 1
        self.in_flight = self.number
        head = json.dumps({**shown.about, "number": self.number}).encode()
        with contextlib.suppress(tornado.websocket.WebSocketClosedError):
            await self.write_message(struct.pack(">I", len(head)) + head + shown.jpeg, binary=True)
        if at_rest:
            # The threads that draw, compile and trace have their own heaps. This takes 3 ms.
            await self._do(thread, give_back_freed_memory)


async def serve(
    config: Config | Callable[[], Config],
    name: str,
    port: int,
    *,
    listening: Callable[[Server], None] = lambda server: None,
    prepared: Callable[[Server], None] = lambda server: None,
    start: Callable[[], None] = lambda: None,
) -> None:
    """Serves pages until `server.ended` is set, or until this task is cancelled.

    **Arguments:**

    - `listening`, `prepared`: called when pages can be opened, and when pictures can be drawn.
    - `start`: called before JAX is loaded, in another thread.

    **Raises** the errors of `start`, of `Server.start`, and of building the configuration.
    """
    server = Server(config, name, start)
    try:
        server.start(port)
        listening(server)
        await server.prepared()
        prepared(server)
        await server.ended.wait()
    finally:
        server.stop()
        await server.hang_up()


def _message_of(text: str | bytes) -> Message:
    """**Raises** `ValueError` for an invalid message."""
    if len(text) > _MAX_MESSAGE:
        raise ValueError(f"the message has {len(text):,} characters; expected at most {_MAX_MESSAGE:,}; send less")
    try:
        asked = Message.model_validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        where, what = ".".join(map(str, first["loc"])), first["msg"]
        if first["type"] == "extra_forbidden":
            what = "there is no such key"
        elif where and isinstance(first["input"], str | int | float | bool | None):
            what = f"{what}, and is {_short(repr(first['input']))}"
        raise ValueError(
            f"{_short(where) or 'the message'}: {printable(what)}; expected a message of this page; reload it"
        ) from None
    if asked == Message():
        parts = ", ".join(Message.model_fields)
        raise ValueError(f"the message is empty; expected an object with one of {parts}; reload the page")
    return asked


def _short(text: str) -> str:
    return printable(text if len(text) <= _SHORT else f"{text[:_SHORT]} …")


def _truth_of(look: Look) -> Any:
    """The key of everything that the reference of `look` can depend on."""
    state = look.state
    numbers = {name: value for name, value in state.numbers.items() if name.startswith("scene.")}
    return state.scene, state.structure, numbers, state.camera, look.light


def check_host(handler: tornado.web.RequestHandler) -> None:
    """Refuses requests for other host names. A page of another host could otherwise reach this server (DNS
    rebinding)."""
    if handler.request.host_name not in (HOST, "localhost"):
        raise tornado.web.HTTPError(403)
