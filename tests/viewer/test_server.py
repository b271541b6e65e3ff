"""The server of pages: one acknowledged picture at a time, and nothing for strangers."""

import asyncio
import contextlib
import gc
import json
import os
import struct
import subprocess
import sys
import threading
import time

import jax
import pytest
from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.websocket import websocket_connect
from viewed import TINY

import diffshadow
from diffshadow.config import ConfigError, build_scene, parse_config
from diffshadow.viewer import _server, _trace
from diffshadow.viewer._server import Server, serve
from diffshadow.viewer._viewer import Viewer

SECONDS = 60


class Talk:
    """A page's end of a connection."""

    def __init__(self, socket):
        self.socket = socket

    async def send(self, **parts):
        await self.socket.write_message(json.dumps(parts))

    async def hear(self, part):
        """The next message with `part`; a picture is `about`, and left without acknowledgement."""
        while True:
            message = await asyncio.wait_for(self.socket.read_message(), SECONDS)
            if isinstance(message, bytes):
                (length,) = struct.unpack(">I", message[:4])
                assert message[4 + length :].startswith(b"\xff\xd8"), "a JPEG"
                message = {"about": json.loads(message[4 : 4 + length])}
            else:
                message = json.loads(message)
            if part in message:
                return message[part]

    async def is_silent(self, seconds=0.6):
        """Whether no picture comes."""
        try:
            while not isinstance(await asyncio.wait_for(self.socket.read_message(), seconds), bytes):
                pass
        except TimeoutError:
            return True
        return False


def talking(script, text=TINY):
    """Runs `script` with a server, and a function that opens pages."""

    async def run():
        server = Server(parse_config(text), "tiny.yaml")
        server.start(0)
        pages = []

        async def opened(**headers):
            request = HTTPRequest(server.address.replace("http", "ws") + "socket", headers=headers)
            pages.append(Talk(await websocket_connect(request)))
            return pages[-1]

        try:
            await script(server, opened)
        finally:
            for page in pages:
                page.socket.close()
            server.stop()
            await asyncio.sleep(0.05)

    asyncio.run(run())


def look(**numbers):
    return {"state": {"numbers": numbers}}


def test_each_picture_waits_for_the_one_before_to_be_shown_and_is_of_the_newest_settings():
    async def script(server, opened):
        page = await opened()
        await page.send(look=look())
        controls = await page.hear("controls")
        assert {slider["key"] for slider in controls["sliders"]} > {"bias.constant", "filter.radius"}
        first = await page.hear("about")
        for constant in (1.0, 2.0, 3.0):
            await page.send(look=look(**{"bias.constant": constant}))
        assert await page.is_silent()
        await page.send(shown=first["number"])
        second = await page.hear("about")
        assert second["number"] == first["number"] + 1
        assert server.last.numbers == {"bias.constant": 3.0}
        await page.send(shown=second["number"])
        # The reference follows by itself.
        figures = await page.hear("about")
        assert figures["rays"] > 0
        assert figures["figures"]["rmse"] > 0

    talking(script)


def test_a_page_can_be_opened_before_anything_is_computed_and_says_what_it_waits_for():
    gate = threading.Event()

    async def run():
        server = Server(lambda: parse_config(TINY), "tiny.yaml", lambda: gate.wait(SECONDS) or None)
        server.start(0)
        page = Talk(await websocket_connect(server.address.replace("http", "ws") + "socket"))
        await page.send(look=look(), stop=True)
        await page.send(save={})
        notes = [await page.hear("note")]
        assert not server.is_made
        gate.set()
        notes += [await page.hear("note"), await page.hear("note")]
        assert [note.split()[0] for note in notes] == ["loading", "reading", "drawing"]
        assert "bias" in (await page.hear("saved"))["yaml"]
        await page.send(look=look())
        await page.hear("about")
        await server.prepared()
        page.socket.close()
        await until_closed(page)
        server.stop()
        await asyncio.sleep(0.05)

    asyncio.run(run())


def test_what_cannot_be_built_is_said_on_pages_and_by_the_command():
    gate, said = threading.Event(), []

    def broken():
        gate.wait(SECONDS)
        return parse_config("scene: {meshes: [path: builtin:bax]}")

    async def read(server):
        page = Talk(await websocket_connect(server.address.replace("http", "ws") + "socket"))
        gate.set()
        said.append(await page.hear("error"))
        assert await until_closed(page)
        page.socket.close()

    async def run():
        reading = []
        listening = lambda server: reading.append(asyncio.ensure_future(read(server)))
        with pytest.raises(ConfigError, match="did you mean 'builtin:box'"):
            await serve(broken, "broken.yaml", 0, listening=listening)
        await reading[0]
        await asyncio.sleep(0.05)

    asyncio.run(run())
    assert said[0].startswith("scene.meshes.0.path: ")


def test_the_command_prints_the_address_before_jax_is_loaded(tmp_path):
    (tmp_path / "tiny.yaml").write_text(TINY)
    program = """
import os, sys, time
from diffshadow.cli import _pages, main
def start():
    time.sleep(0.5)
    loaded = {"jax", "trimesh", "PIL", "matplotlib", "numpy"} & set(sys.modules)
    print(sorted(loaded), flush=True)
    os._exit(0)
_pages.start_jax = start
main(["view", "tiny.yaml", "--no-browser"])
"""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=SECONDS
    )
    assert done.stderr == ""
    address, how, loaded = done.stdout.splitlines()
    assert address.startswith("http://127.0.0.1:")
    assert (how, loaded) == ("Ctrl-C ends it", "[]")


def test_two_pages_have_settings_of_their_own_and_a_page_that_leaves_disturbs_none():
    async def script(server, opened):
        one, other = await opened(), await opened()
        await one.send(look=look(**{"bias.constant": 1.0}))
        await other.send(look=look(**{"scene.light.azimuth": 10.0}))
        await one.hear("about")
        one.socket.close()
        await other.hear("about")
        await asyncio.sleep(0.05)
        assert len(server.pages) == 1

    talking(script)


def test_no_page_waits_for_what_another_has_to_compile(monkeypatch):
    compiled, draw = threading.Event(), Viewer.show

    def show(viewer, look, **options):
        assert not look.state.structure or compiled.wait(SECONDS)
        return draw(viewer, look, **options)

    monkeypatch.setattr(Viewer, "show", show)

    async def script(server, opened):
        one, other = await opened(), await opened()
        await one.send(look=look())
        full = await one.hear("about")
        while not full["is_full"]:
            await one.send(shown=full["number"])
            full = await one.hear("about")
        await other.send(look={"state": {"structure": {"filter": {"type": "bilinear"}}}})
        await other.hear("controls")
        await one.send(look=look(**{"bias.constant": 1.0}), shown=full["number"])
        assert (await one.hear("about"))["number"] == full["number"] + 1
        compiled.set()
        await other.hear("about")

    talking(script)


def test_freed_memory_is_given_back_at_rest_and_not_while_a_slider_is_dragged(monkeypatch):
    given = []
    monkeypatch.setattr(_server, "give_back_freed_memory", lambda: given.append(threading.current_thread().name))

    async def script(server, opened):
        page = await opened()
        await page.send(look=look(**{"scene.light.azimuth": 41.0}))
        about = await page.hear("about")
        assert not about["is_full"]
        assert given == []
        await page.send(shown=about["number"])
        assert (await page.hear("about"))["is_full"]
        assert await page.is_silent(0.1)
        assert [name.partition("_")[0] for name in given] == ["compiling"]

    talking(script)


def test_a_page_at_rest_gets_its_reference_while_another_is_dragged():
    async def script(server, opened):
        one, other = await opened(), await opened()
        await one.send(look=look(**{"scene.light.azimuth": 20.0}))
        shown = await one.hear("about")
        until = time.monotonic() + SECONDS
        azimuth = 21.0
        while not shown["rays"] and time.monotonic() < until:
            # The other page never rests.
            azimuth += 0.5
            await other.send(look=look(**{"scene.light.azimuth": azimuth}))
            await other.send(shown=(await other.hear("about"))["number"])
            await one.send(shown=shown["number"])
            with contextlib.suppress(TimeoutError):
                shown = await asyncio.wait_for(one.hear("about"), 0.1)
        assert shown["rays"]

    talking(script)


def test_a_page_at_rest_gets_each_reference_once_and_then_nothing(monkeypatch, tmp_path):
    monkeypatch.setenv("DIFFSHADOW_CACHE", str(tmp_path))
    asked, trace = [], _trace.reference.trace_visibility

    def tracing(scene, **how):
        asked.append(how["samples"])
        # So long that the picture with the rays before is shown meanwhile, as at real sizes.
        time.sleep(0.4)
        how["progress"](0.5)
        return trace(scene, **how)

    monkeypatch.setattr(_trace.reference, "trace_visibility", tracing)

    async def script(server, opened):
        page = await opened()
        await page.send(look=look(**{"scene.light.azimuth": 31.0}))
        rays = []
        while 16 not in rays:
            about = await page.hear("about")
            rays.append(about["rays"])
            if about["rays"] == 4 and rays.count(4) == 1:
                # A bias needs no other reference.
                await page.send(look=look(**{"scene.light.azimuth": 31.0, "bias.constant": 1.0}))
            await page.send(shown=about["number"])
        assert sorted(set(rays)) == [0, 4, 16]
        assert len(rays) <= 5
        calls = server.viewer.cache.visibility.calls
        assert await page.is_silent(0.8)
        assert server.viewer.cache.visibility.calls == calls
        assert asked == [4, 16]

    talking(script)


WRONG = [
    ("no JSON", "Invalid JSON"),
    ('{"look": {"state": {"numbers": {"a": "b"}}}}', "look.state.numbers.a"),
    ('{"look": {"state": {}, "view": "x-ray"}}', "look.view"),
    ('{"look": {"state": {"numbers": {"bias.constant": 1e999}}}}', "look.state.numbers.bias.constant"),
    ('{"steal": 1}', "steal"),
    ("[]", "the message"),
    ("{}", "the message is empty; expected an object with one of look, shown, save, code, picture, fit, stop"),
    ("x" * (1 << 20), "the message has 1,048,576 characters; expected at most 262,144; send less"),
    ('{"stop": "maybe"}', "stop: Input should be a valid boolean"),
    ('{"shown": 1.5}', "is 1.5"),
    ('{"shown": ' + "9" * 5000 + "}", "number out of range"),
    ('{"look": {"state": {"camera": {"eye": [1e30, 0, 0], "target": [0, 0, 0]}}}}', "look.state.camera.eye.0"),
    ('{"look": {"state": {"camera": {"eye": [0, 0, 0], "target": [0, 0, 0]}}}}', "expected"),
    ('{"look": {"state": {"numbers": {"bias.constant": NaN}}}}', "look.state.numbers.bias.constant"),
    ('{"look": {"state": {"numbers": {"bias.constant": "1"}}}}', "is '1'"),
    ('{"look": {"state": {"numbers": {"bias.foo": 1}}}}', "bias.foo is not a number of this configuration"),
    ('{"look": {"state": {"numbers": {"bias.constant": 9}}}}', "bias.constant is 9; expected a number from 0 to 8"),
    ('{"look": {"state": {"numbers": {"' + "a" * 5000 + '": 1}}}}', "at most 256 characters"),
    ('{"look": {"state": {"structure": {"": 1}}}}', "at least 1 character"),
    ('{"look": {"state": {"structure": {"filter": ' + "[" * 190 + "]" * 190 + "}}}}", "expected"),
    ('{"save": {"numbers": {"bias.foo": 1}}}', "bias.foo is not a number of this configuration"),
    ('{"code": {"state": {"numbers": {"bias.foo.0": 1}}}}', "bias.foo.0 is not a number of this configuration"),
    ('{"fit": {"fitted": ["bias.foo"]}}', "bias.foo is not a number of this configuration"),
    ('{"fit": {"fitted": []}}', "nothing is chosen to be fitted"),
    ('{"look": {"state": {"structure": {"filter": {"type": "pfc"}}}}}', "did you mean 'pcf'"),
    ('{"look": {"state": {"structure": {"output": "/etc"}}, "light": 3}}', None),
]


def test_a_wrong_message_is_answered_and_stops_nothing():
    async def script(server, opened):
        for message, said in WRONG:
            page = await opened()
            await page.socket.write_message(message)
            if said is not None:
                answer = await page.hear("error")
                assert said in answer, message
                assert len(answer) < 500
                assert not any(word in answer for word in ("Error", "Traceback", "\n"))
        await page.send(look=look())
        await page.hear("about")

    talking(script)


def test_settings_are_saved_and_converted():
    async def script(server, opened):
        page = await opened()
        await page.send(save={"numbers": {"bias.constant": 1.5}})
        saved = await page.hear("saved")
        assert parse_config(saved["yaml"]).bias.constant == 1.5
        assert saved["name"] == "tiny-view.yaml"
        assert saved["command"] == "diffshadow render tiny.yaml bias.constant=1.5"
        await page.send(code={"state": {"numbers": {"bias.constant": 1.5}, "structure": {"bias.slope": 0.0}}})
        assert "three.js" in await page.hear("code")

    talking(script)


def test_pages_and_hosts_of_others_are_refused():
    async def script(server, opened):
        client = AsyncHTTPClient()
        page = await client.fetch(server.address)
        assert "default-src 'none'" in page.headers["Content-Security-Policy"]
        for name in ("page.css", "page.js"):
            text = (await client.fetch(server.address + name)).body.decode()
            # Nothing is loaded from elsewhere.
            assert "http://" not in text
            assert "https://" not in text
        for path, headers in (("", {"Host": "example.com"}), ("etc/passwd", {}), ("_server.py", {})):
            found = await client.fetch(server.address + path, headers=headers, raise_error=False)
            assert found.code in (403, 404)
        # A page of another origin; and one whose name leads here.
        for host, origin in ((None, "http://example.com"), ("example.com", "http://example.com")):
            with pytest.raises(Exception, match="403"):
                await opened(Origin=origin, **({} if host is None else {"Host": host}))

    talking(script)


def test_a_port_that_is_taken_is_said():
    async def script(server, opened):
        port = int(server.address.rsplit(":", 1)[1].strip("/"))
        with pytest.raises(ValueError, match=f"--port is {port}, which cannot be used"):
            Server(parse_config(TINY), "tiny.yaml").start(port)
        with pytest.raises(ValueError, match="expected a free port from 0 to 65535"):
            Server(parse_config(TINY), "tiny.yaml").start(70000)

    talking(script)


def test_a_page_beside_python_has_the_values_that_it_was_left_with(tmp_path):
    (tmp_path / "tiny.yaml").write_text(TINY)
    page = diffshadow.view(tmp_path / "tiny.yaml", "bias.slope=0.25")
    assert page.values == {}
    assert page.address in page._repr_html_()

    async def drag():
        talk = Talk(await websocket_connect(page.address.replace("http", "ws") + "socket"))
        await talk.send(look=look(**{"bias.constant": 2.5}))
        await talk.hear("about")
        talk.socket.close()
        await asyncio.sleep(0.05)

    asyncio.run(drag())
    assert page.values == {"bias.constant": 2.5}
    assert (page.config.bias.constant, page.config.bias.slope) == (2.5, 0.25)
    page.close()


async def until_closed(talk):
    """Whether the connection ends."""
    for _ in range(100):
        if await asyncio.wait_for(talk.socket.read_message(), SECONDS) is None:
            await asyncio.sleep(0.02)
            return True
    return False


def held():
    """Threads, file descriptors, and arrays of JAX."""
    gc.collect()
    # Threads of JAX that have called Python are dummies.
    threads = [thread.name for thread in threading.enumerate() if "Dummy" not in thread.name]
    return sorted(threads), len(os.listdir("/proc/self/fd")), len(jax.live_arrays())


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_page_that_is_closed_leaves_nothing_behind():
    config = parse_config(TINY)

    async def looked_at(page, *, is_left, fits):
        talk = Talk(await websocket_connect(page.address.replace("http", "ws") + "socket"))
        await talk.send(look=look(**{"bias.constant": 2.5}))
        await talk.hear("about")
        if fits:
            await talk.send(fit={})
            await talk.hear("started")
        if is_left:
            talk.socket.close()
            await until_closed(talk)
        # With a page that is connected, a picture in flight, and sometimes a fit under way.
        await asyncio.to_thread(page.close)
        assert is_left or await until_closed(talk)
        talk.socket.close()

    before = None
    for count in range(5):
        page = diffshadow.view(config)
        asyncio.run(looked_at(page, is_left=count % 2 == 0, fits=count in (1, 2)))
        page.close()
        assert page.values == {"bias.constant": 2.5}
        assert page.config.bias.constant == 2.5
        assert repr(page) == page._repr_html_() == f"a closed page at {page.address}"
        # The first one loads what stays.
        before = before or held()
    threads, descriptors, arrays = held()
    assert (threads, descriptors) == before[:2]
    # JAX keeps what the last callback that was stopped was given.
    assert arrays <= before[2] + 3


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_page_that_does_not_open_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    config = parse_config(TINY)
    with diffshadow.view(config) as page:
        port = int(page.address.rsplit(":", 1)[1].strip("/"))
        before = held()
        for what in (config, build_scene(config)):
            with pytest.raises(ValueError, match=f"--port is {port}"):
                diffshadow.view(what, port=port)
        del what
        assert held() == before
    assert list(tmp_path.iterdir()) == []


@pytest.mark.exhaustive
@pytest.mark.parametrize("left", ["", "server.viewer.start_fit(State())"])
def test_python_ends_with_a_page_that_is_open(tmp_path, left):
    (tmp_path / "tiny.yaml").write_text(TINY)
    script = f"""
import diffshadow
from diffshadow.viewer import Look, State
page = diffshadow.view("tiny.yaml")
server = page._server
server.viewer.trace(Look(state=State()))
{left}
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.exhaustive
def test_a_scene_of_python_is_shown_with_its_meshes_camera_and_lights(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    lamp = {"type": "spot", "position": [1, 3, 1], "radius": 0.1}
    lit_by = f"scene.lights=[{{azimuth: -60, elevation: 50, angular_radius: 2}}, {json.dumps(lamp)}]"
    several = build_scene(parse_config(TINY, ["scene.light=null", lit_by]))
    page = diffshadow.view(several, "shadow_map.resolution=[64, 64]")
    sun, spot = page.config.scene.lights
    assert (sun.type, spot.type) == ("directional", "spot")
    assert (sun.angular_radius, spot.radius) == pytest.approx((2, 0.1), abs=1e-4)
    assert spot.position == pytest.approx((1, 3, 1), abs=1e-4)
    page.close()
    scene = build_scene(parse_config(TINY))
    page = diffshadow.view(scene, "shadow_map.resolution=[64, 64]")
    shown = page.config.scene
    assert len(shown.meshes) == 2
    assert shown.camera.eye == pytest.approx((2, 2.5, 3), abs=1e-4)
    assert shown.light.angular_radius == pytest.approx(2, abs=1e-4)
    assert len(list(tmp_path.iterdir())) == 1
    page.close()
    assert list(tmp_path.iterdir()) == []
    assert page.config.scene == shown


def test_other_objects_are_refused():
    with pytest.raises(TypeError, match="what to view is of type int; expected a configuration"):
        diffshadow.view(3)
    with pytest.raises(ValueError, match="overrides are given with a Config"):
        diffshadow.view(parse_config(TINY), "bias.slope=0")
