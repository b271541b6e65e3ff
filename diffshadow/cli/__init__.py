"""The command `diffshadow`.

It imports as little as possible, so that mistakes in a configuration are reported in a fraction of a second, before
JAX is loaded.
"""

# These add their commands to the program.
from . import _engines as _engines
from . import _pages as _pages
from . import _runs as _runs
from . import _sweeps as _sweeps
from ._main import main as main
