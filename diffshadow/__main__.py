"""`python -m diffshadow` is the command `diffshadow`."""

from .cli import main

if __name__ == "__main__":
    main()
