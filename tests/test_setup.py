"""How a process is set up for fast work."""

import atexit
import gc
import os
import subprocess
import sys
import warnings

import jax.numpy as jnp
import pytest

import diffshadow

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


def test_importing_starts_no_backend_and_leaves_its_flags_alone_until_all_cores_are_asked_for():
    without = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    subprocess.run([sys.executable, "-W", "error", "-c", FRESH], env=without, check=True)


def test_one_call_sets_a_process_up_and_each_part_has_a_switch(tmp_path):
    unset = {"XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR"}
    without = {name: value for name, value in os.environ.items() if name not in unset}
    run = [sys.executable, "-W", "error", "-c", SET_UP, str(tmp_path / "programs")]
    subprocess.run(run, env=without, check=True)
    assert (tmp_path / "programs").is_dir()


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
