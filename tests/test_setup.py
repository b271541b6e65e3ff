"""How a process is set up for fast work."""

import atexit
import contextlib
import gc
import os
import pty
import subprocess
import sys
import types
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

import diffshadow
from diffshadow import _display, _memory, limit_programs

FRESH = """
import os
import diffshadow
from diffshadow import fit, geometry, metrics, reference, shading, shadow, study

assert "XLA_FLAGS" not in os.environ, "an import changed it"
diffshadow.use_all_cores()
flags = os.environ["XLA_FLAGS"]
assert "small_while_loop_byte_threshold=5120" in flags
diffshadow.use_all_cores()
assert os.environ["XLA_FLAGS"] == flags
"""

SET_UP = """
import gc
import os
import sys
import diffshadow

before = gc.get_threshold()
diffshadow.setup(cores=False, memory=False, collector=False, programs=False)
assert "XLA_FLAGS" not in os.environ and gc.get_threshold() == before
diffshadow.setup(programs=False)
assert "small_while_loop_byte_threshold" in os.environ["XLA_FLAGS"] and gc.get_threshold() != before
# What takes long to load is loaded on first use.
assert not {"jax", "trimesh", "importlib.metadata"} & set(sys.modules)
diffshadow.setup(programs=sys.argv[1])
import jax
assert jax.config.jax_compilation_cache_dir == sys.argv[1]
"""


@pytest.mark.exhaustive
def test_importing_starts_no_backend_and_leaves_its_flags_alone_until_all_cores_are_asked_for():
    without = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    subprocess.run([sys.executable, "-W", "error", "-c", FRESH], env=without, check=True)


def test_one_call_sets_a_process_up_and_each_part_has_a_switch(tmp_path):
    unset = {"XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR"}
    without = {name: value for name, value in os.environ.items() if name not in unset}
    run = [sys.executable, "-W", "error", "-c", SET_UP, str(tmp_path / "programs")]
    subprocess.run(run, env=without, check=True)
    assert (tmp_path / "programs").is_dir()


SHOWS = """
import os, signal, sys, time
import diffshadow
from diffshadow._progress import showing

diffshadow.setup(cores=False, memory=False, collector=False, programs=False)
assert "rich" not in sys.modules
with showing("work [1]") as update:
    with showing("inner") as inner:
        assert inner is None
    if update is not None:
        update("half [2]", 0.5)
        time.sleep(0.3)
    if sys.argv[1] == "interrupt":
        # The background job of a script starts with Ctrl-C ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.kill(os.getpid(), signal.SIGINT)
diffshadow.setup(cores=False, memory=False, collector=False, programs=False, progress=False)
with showing("work") as update:
    assert update is None
"""
# What a terminal takes as: hide the cursor, show it, and erase the line.
HIDE, SHOW, ERASE = b"\x1b[?25l", b"\x1b[?25h", b"\x1b[2K"


def shown_in_terminal(*arguments, **more):
    """What the script writes to a terminal's stderr."""
    left_out = {"PYTEST_CURRENT_TEST", "TERM", "NO_COLOR"}
    environment = {name: value for name, value in os.environ.items() if name not in left_out}
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", SHOWS, *arguments]
    process = subprocess.Popen(command, stderr=theirs, env={**environment, "TERM": "xterm", **more})
    os.close(theirs)
    told = b""
    # Reading fails once the other end is closed.
    with contextlib.suppress(OSError):
        while part := os.read(ours, 4096):
            told += part
    os.close(ours)
    return told, process.wait()


@pytest.mark.parametrize("end", ["done", "interrupt"])
def test_a_terminal_shows_one_line_that_vanishes(end):
    told, code = shown_in_terminal(end)
    assert (code == 0) == (end == "done"), told
    assert b"work [1]" in told
    assert b"half [2]" in told
    assert told.index(HIDE) < told.index(b"half") < told.index(SHOW) < told.rindex(ERASE)
    left = told[told.rindex(ERASE) + len(ERASE) :]
    assert left == b"" if end == "done" else b"KeyboardInterrupt" in left


def test_progress_is_shown_to_no_pipe_and_not_where_it_is_turned_off():
    assert shown_in_terminal("done", DIFFSHADOW_PROGRESS="0") == (b"", 0)
    assert shown_in_terminal("done", PYTEST_CURRENT_TEST="here") == (b"", 0)
    ran = subprocess.run([sys.executable, "-c", SHOWS, "done"], capture_output=True, check=True)
    assert ran.stderr == b""


def test_a_notebook_shows_one_line_that_vanishes(monkeypatch):
    told = []
    handle = types.SimpleNamespace(update=lambda html: told.append(html.data))
    ipython = pytest.importorskip("IPython.display")
    monkeypatch.setattr(ipython, "display", lambda html, display_id: told.append(html.data) or handle)
    monkeypatch.setattr(_display, "_is_notebook", lambda: True)
    monkeypatch.setattr(_display, "_PAUSE", -1.0)
    with contextlib.suppress(KeyboardInterrupt), _display.display("<work>") as update:
        update("half", 0.5)
        raise KeyboardInterrupt
    assert told == ["&lt;work&gt; <progress></progress> ", '&lt;work&gt; <progress value="0.500"></progress> half', ""]


def test_all_cores_come_too_late_once_jax_runs(monkeypatch):
    jnp.zeros(1).block_until_ready()
    monkeypatch.setenv("XLA_FLAGS", "--xla_dump_to=here")
    with pytest.warns(RuntimeWarning, match="JAX's backend already runs.* call it right after the imports") as caught:
        diffshadow.setup(memory=False, collector=False, programs=False)
    assert caught[0].filename == __file__
    assert os.environ["XLA_FLAGS"] == "--xla_dump_to=here"
    # Options of the user's own are left alone, and so is one that is set already.
    monkeypatch.setenv("XLA_FLAGS", "--xla_backend_extra_options=xla_cpu_disable_loop_unrolling")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        diffshadow.use_all_cores()
    assert os.environ["XLA_FLAGS"].endswith("disable_loop_unrolling")


def test_the_collector_runs_rarely_and_searches_nothing_at_the_exit(monkeypatch):
    at_exit, before = [], gc.get_threshold()
    monkeypatch.setattr(atexit, "register", at_exit.append)
    try:
        diffshadow.collect_rarely()
        assert gc.get_threshold()[0] > 10_000
    finally:
        gc.set_threshold(*before)
    assert at_exit == [gc.freeze]


def test_programs_are_dropped_when_they_take_many_mappings(monkeypatch):
    calls = []
    program = jax.jit(lambda x: calls.append(None) or x + 1)
    program(1.0)
    limit_programs()
    program(1.0)
    assert len(calls) == 1
    monkeypatch.setattr(_memory, "_MAX_MAPPINGS", 10)
    limit_programs()
    program(1.0)
    assert len(calls) == 2
    # Where the system does not say, nothing is dropped.
    monkeypatch.setattr(_memory, "_MAPPINGS", Path("missing"))
    limit_programs()
    program(1.0)
    assert len(calls) == 2
