"""Every test runs with jaxtyping's shapes checked by beartype, and programs are compiled once on a machine.

The process that hands the tests to workers runs none: JAX is imported in functions, so that it is spared there.
"""

import gc
import os
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

from diffshadow import collect_rarely, limit_programs, use_all_cores

_ARRAYS = ("_arithmetic", "_padding", "fit", "geometry", "metrics", "raster", "reference", "shading", "shadow")
install_import_hook([f"diffshadow.{name}" for name in _ARRAYS], "lazy_checks.checked")

# Of the file system, whatever the tests set DIFFSHADOW_CACHE to.
PROGRAMS = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "diffshadow-tests"
"""Where compiled programs are kept, for this clone and the next; JAX's keys tell versions and machines apart."""
_MAX_BYTES = 1 << 30

collect_rarely()


def pytest_configure(config):
    """Lets JAX keep what it compiles: that is most of the work. Processes that tests start do so too."""
    # Compiled programs depend on it.
    use_all_cores()
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(PROGRAMS))
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    if worker is None and config.getoption("numprocesses", None):
        return
    import jax

    jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    if worker in (None, "gw0") and os.environ["JAX_COMPILATION_CACHE_DIR"] == str(PROGRAMS):
        from diffshadow.io import prune_cache  # after the hook is installed

        prune_cache(PROGRAMS, _MAX_BYTES)


def pytest_collection_modifyitems(items):
    """Optimized tests come first: other tests can reuse their programs, but not the other way round."""
    items.sort(key=lambda item: item.get_closest_marker("optimized") is None)


def pytest_collection_finish():
    """Modules and tests live to the end: the garbage collector need not look through them again."""
    gc.freeze()


@pytest.fixture(scope="module", autouse=True)
def _optimize(request):
    """Has programs optimized where tests are marked `optimized`, and elsewhere not: they compile in two thirds of the
    time. So do processes that tests start."""
    import jax

    was_plain = os.environ.get("JAX_DISABLE_MOST_OPTIMIZATIONS") == "True"
    is_plain = request.node.get_closest_marker("optimized") is None
    jax.config.update("jax_disable_most_optimizations", is_plain)
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = str(is_plain)
    if was_plain and not is_plain:
        # JAX would otherwise reuse programs that were compiled without optimizations.
        jax.clear_caches()


@pytest.fixture(scope="module", autouse=True)
def _forget_programs():
    """Programs stay loaded from file to file, until they take too much."""
    yield
    limit_programs()
