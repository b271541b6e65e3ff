"""Every test runs with jaxtyping's shapes checked by beartype."""

import gc
from pathlib import Path

import jax
import pytest
from jaxtyping import install_import_hook

install_import_hook("diffshadow", "beartype.beartype")

_MAPPINGS = Path("/proc/self/maps")
# Linux allows a process 65,530, and each compiled program takes several.
_MOST_MAPPINGS = 20_000


@pytest.fixture(scope="module", autouse=True)
def _forget_programs():
    """Compiled programs are kept from file to file, until they take too much."""
    yield
    if not _MAPPINGS.exists() or _MAPPINGS.read_bytes().count(b"\n") > _MOST_MAPPINGS:
        jax.clear_caches()
        gc.collect()
