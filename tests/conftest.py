"""Every test runs with jaxtyping's shapes checked by beartype."""

import gc

import jax
import pytest
from jaxtyping import install_import_hook

install_import_hook("diffshadow", "beartype.beartype")


@pytest.fixture(scope="module", autouse=True)
def _forget_programs():
    """Compiled programs of a file are dropped at its end: a process may hold only so many mappings of memory."""
    yield
    jax.clear_caches()
    gc.collect()
