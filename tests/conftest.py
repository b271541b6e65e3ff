"""Every test runs with jaxtyping's shapes checked by beartype."""

import gc
import os
from pathlib import Path

import jax
import pytest
from jaxtyping import install_import_hook

install_import_hook("diffshadow", "beartype.beartype")

_MAPPINGS = Path("/proc/self/maps")
# Linux allows a process 65,530, and each compiled program takes several.
_MOST_MAPPINGS = 20_000

# Tracing makes millions of objects that live: looking through them as often as Python does costs 7 % of the time.
gc.set_threshold(200_000, 20, 100)


def pytest_configure(config):
    """Compiled programs are kept from run to run: compiling is two thirds of the work."""
    chosen = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if chosen or hasattr(config, "cache"):
        jax.config.update("jax_compilation_cache_dir", chosen or str(config.cache.mkdir("jax")))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


@pytest.fixture(scope="module", autouse=True)
def _forget_programs():
    """Programs stay loaded from file to file, until they take too much."""
    yield
    if not _MAPPINGS.exists() or _MAPPINGS.read_bytes().count(b"\n") > _MOST_MAPPINGS:
        jax.clear_caches()
        gc.collect()
