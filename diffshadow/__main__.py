"""`python -m diffshadow` is the command `diffshadow`."""

import sys
from typing import NoReturn


def main() -> NoReturn:
    """Runs the command with the process's arguments, and exits as `diffshadow.cli.main` says."""
    try:
        from .cli import main as run
    except KeyboardInterrupt:
        # Importing takes long enough for Ctrl-C to come before there is anything else to catch it.
        print("error: interrupted", file=sys.stderr)
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
