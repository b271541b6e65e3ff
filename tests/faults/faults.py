"""Mistakes that the tests must see, each a change of one place in the package's source.

Each is one that a programmer could make and a user would suffer from. They stand in a YAML file for each subpackage,
by the file that they change. `run.py` puts them in, one at a time, and says which test finds them.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import yaml


class Fault(NamedTuple):
    """A mistake.

    - `name`: in a few words.
    - `file`: below `diffshadow/`; `old`: text that stands there exactly once; `new`: what takes its place.
    - `tests`: files of tests that are likely to see it, the likeliest first, by name wherever they lie.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    @property
    def subpackage(self) -> str:
        """The subpackage that it lies in, or the module of the package itself."""
        return self.file.partition("/")[0].removesuffix(".py")


def _read() -> Iterator[Fault]:
    for listed in sorted(Path(__file__).parent.glob("*.yaml")):
        for file, faults in yaml.safe_load(listed.read_text(encoding="utf-8")).items():
            for fault in faults:
                yield Fault(fault["name"], file, fault["old"], fault["new"], tuple(fault["tests"].split()))


FAULTS = tuple(_read())
