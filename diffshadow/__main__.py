"""`python -m diffshadow` runs the command `diffshadow`."""

import sys
from typing import NoReturn


def main() -> NoReturn:
    """Runs the command with the process's arguments, and exits with the code of `diffshadow.cli.main`."""
    try:
        from .cli import main as run
    except KeyboardInterrupt:
        # The import takes long enough for Ctrl-C to arrive before any other handler exists.
        print("error: interrupted", file=sys.stderr)
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
