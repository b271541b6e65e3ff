"""Sweeps on workers that share no files with the command: they have another folder, home and cache."""

import ast
import contextlib
import importlib.metadata
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest
from rich.console import Console
from scenes import staying_in

from diffshadow import io, study
from diffshadow.config import load_sweep
from diffshadow.study.sweeps import _pool
from diffshadow.study.sweeps._code import Code, asked_of, own_code

pytestmark = pytest.mark.usefixtures("tiny_figures")

ROOT = Path(__file__).parents[2]
SWEEP = """
scene:
  meshes:
    - {path: meshes/triangle.gltf, translate: [0, 0.3, 0]}
    - {path: builtin:plane, options: {size: 3}}
  camera: {resolution: [16, 16], orbit: {distance: 4}}
  light: {angular_radius: 1.5}
shadow_map: {resolution: [16, 16]}
filter: {samples: 4}
reference: {samples: 4}
output: runs
sweep: {grid: {filter.radius: [1, 2.5]}, repeats: 4}
"""
# Reads and writes no file of the command's folder, and leaves small figures.
PRELOAD = """
import os, sys
from pathlib import Path
forbidden = {forbidden!r}

def refuse(event, arguments):
    if event in ("open", "os.listdir", "os.scandir", "os.mkdir", "os.rename", "os.remove"):
        if any(isinstance(path, (str, os.PathLike)) and os.fspath(path).startswith(forbidden) for path in arguments):
            raise PermissionError(f"{{event}} of {{arguments}}: no file of the command is here")

sys.addaudithook(refuse)
from diffshadow.study import style
style.save = lambda figure, path, dpi=None: path.write_bytes(b"")
"""
# A user's filter, in a file or a package.
FILTER = """
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float
from diffshadow import shadow

class Corners(shadow.AbstractFilter):
    radius: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=1.5)

    def __call__(self, shadow_map, lookup, compare):
        return shadow.FourTap(self.radius)(shadow_map, lookup, compare)
"""
# Runs that take no time.
QUICK = """
import time
from diffshadow.study.sweeps import _work

def measure(config, batch, stages):
    time.sleep({seconds})
    errors = dict.fromkeys(("rmse", "mae", "ssim", "false_shadow_rate", "false_light_rate"), 0.25)
    return {{**errors, "rmse": config.filter.radius / 99, "reference_noise_floor": 0.0, "pixels": 99}}

_work._MEASURES["render"] = measure
"""


@pytest.fixture(scope="module", autouse=True)
def _compiled_anew():
    """Workers compile without optimizations. Optimized programs of earlier tests would round otherwise."""
    jax.clear_caches()


@pytest.fixture(autouse=True)
def apart(tmp_path, monkeypatch):
    """Each test in a folder of its own, with a mesh of two files."""
    monkeypatch.setenv("DIFFSHADOW_CACHE", str(tmp_path / "here" / "cache"))
    (tmp_path / "here" / "meshes").mkdir(parents=True)
    with staying_in(tmp_path / "here"):
        Path("s.yaml").write_text(SWEEP)
        _write_triangle(Path("meshes"))
        yield


def _write_triangle(folder: Path) -> None:
    corners = np.array([[-0.4, 0, 0], [0.4, 0, 0], [0, 0.6, 0.1]], np.float32)
    (folder / "corners.bin").write_bytes(corners.tobytes())
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"uri": "corners.bin", "byteLength": corners.nbytes}],
        "bufferViews": [{"buffer": 0, "byteLength": corners.nbytes}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 3,
                "type": "VEC3",
                "min": corners.min(0).tolist(),
                "max": corners.max(0).tolist(),
            }
        ],
    }
    (folder / "triangle.gltf").write_text(json.dumps(document))


class Elsewhere:
    """A scheduler, and workers in other folders."""

    def __init__(self, tmp_path: Path, preload: str = ""):
        from distributed import LocalCluster

        self._folder, self._workers = tmp_path, []
        self._preload = PRELOAD.format(forbidden=str(tmp_path / "here")) + preload
        self._cluster = LocalCluster(
            n_workers=0, processes=False, protocol="tcp://", host="127.0.0.1", dashboard_address="127.0.0.1:0"
        )
        self.address = self._cluster.scheduler_address

    def start(self, version: str | None = None, *, change: str = "", site: str = "") -> subprocess.Popen:
        """Starts a worker.

        **Arguments:** `version`: of its package, if it is another one; `change`: what its package has more in a module;
        `site`: what its Python runs first, in place of `preload`.
        """
        folder = self._folder / f"worker{len(self._workers)}"
        folder.mkdir()
        (folder / "preload.py").write_text("" if site else self._preload)
        (folder / "sitecustomize.py").write_text(site)
        path = [str(folder), str(ROOT)]
        if change:
            path.insert(0, str(folder / "changed"))
            shutil.copytree(ROOT / "diffshadow", folder / "changed" / "diffshadow")
            with (folder / "changed" / "diffshadow" / "shadow" / "_compare.py").open("a") as module:
                module.write(change)
        if version is not None:
            path.insert(0, str(folder / "old"))
            made = folder / "old" / f"diffshadow-{version}.dist-info"
            made.mkdir(parents=True)
            (made / "METADATA").write_text(f"Metadata-Version: 2.1\nName: diffshadow\nVersion: {version}\n")
        known = {name: os.environ[name] for name in ("PATH", "JAX_COMPILATION_CACHE_DIR") if name in os.environ}
        command = ["-m", "distributed.cli.dask_worker", self.address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
        options = ["--preload", str(folder / "preload.py"), "--local-directory", str(folder)]
        environment = {
            **known,
            "HOME": str(folder),
            "PYTHONPATH": os.pathsep.join(path),
            "JAX_DISABLE_MOST_OPTIMIZATIONS": os.environ.get("JAX_DISABLE_MOST_OPTIMIZATIONS", "False"),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        }
        with (folder / "out").open("w") as out:
            worker = subprocess.Popen(
                [sys.executable, *command, *options], cwd=folder, env=environment, stdout=out, stderr=subprocess.STDOUT
            )
        self._workers.append(worker)
        return worker

    def wait_for(self, count: int) -> None:
        """Waits for so many workers."""
        scheduler: Any = self._cluster.scheduler
        until(lambda: len(scheduler.workers) >= count)

    def close(self) -> None:
        """Ends workers and scheduler."""
        for worker in self._workers:
            worker.kill()
            worker.wait()
        self._cluster.close()


def until(true: Callable[[], bool], seconds: float = 60) -> None:
    """Waits until something is true."""
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@contextlib.contextmanager
def elsewhere(tmp_path: Path, workers: int = 0, preload: str = "") -> Iterator[Elsewhere]:
    """A scheduler with so many workers in other folders."""
    made = Elsewhere(tmp_path, preload)
    try:
        for _ in range(workers):
            made.start()
        made.wait_for(workers)
        yield made
    finally:
        made.close()


def quiet() -> Console:
    return Console(quiet=True)


def files_in(folder: Path) -> dict[str, bytes]:
    """The files of runs in a sweep's folder by name, without the times that they took."""
    found = {str(file.relative_to(folder)): file.read_bytes() for file in folder.glob("*/*/*") if file.is_file()}
    found["results.parquet"] = (folder / "results.parquet").read_bytes()
    timeless = lambda content: re.sub(rb'"seconds": {[^}]*}', b"", content)
    return {
        name: timeless(content) if name.endswith(".json") else content
        for name, content in found.items()
        if name.endswith((".json", ".yaml", ".parquet"))
    }


Act = Callable[[Elsewhere, Path], None]


def both(
    tmp_path: Path, overrides: list[str], *, before: Act | None = None, during: Act | None = None, workers: int = 1
) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """The files of a sweep that is done on workers elsewhere, and in this process.

    **Arguments:** `before`, `during`: what happens before and during the first, given the workers and the sweep's
    folder.
    """
    sweep = load_sweep(Path("s.yaml"), overrides)
    with elsewhere(tmp_path, workers) as cluster:
        folder = Path("runs/s-sweep").absolute()
        if before:
            before(cluster, folder)
        thread = threading.Thread(target=during, args=(cluster, folder)) if during else None
        if thread:
            thread.start()
        there = study.run_sweep(sweep, console=quiet(), scheduler=cluster.address)
        if thread:
            thread.join()
    found = files_in(there)
    there.rename("there")
    return found, files_in(study.run_sweep(sweep, console=quiet(), workers=0))


@pytest.mark.exhaustive
def test_workers_need_none_of_the_files(tmp_path):
    there, here = both(tmp_path, [])
    assert there == here
    assert sum(b'"status": "ok"' in content for content in there.values()) == 8
    # The worker traced them, and they are kept here.
    assert io.cache_size(tmp_path / "here" / "cache")[0] == 4


@pytest.mark.exhaustive
def test_a_worker_with_another_version_is_refused_by_name(tmp_path, monkeypatch):
    here = importlib.metadata.version("diffshadow")
    with elsewhere(tmp_path) as cluster:
        cluster.start(version="0.0.1")
        cluster.wait_for(1)
        with pytest.raises(ValueError, match=rf"worker at tcp://\S+ has diffshadow 0\.0\.1; expected {here}"):
            study.run_sweep(load_sweep(Path("s.yaml")), console=quiet(), scheduler=cluster.address)
        # The command asks a worker that joins later only when something fails.
        monkeypatch.setattr(_pool.OnCluster, "check_versions", _only_again(_pool.OnCluster.check_versions))
        with pytest.raises(ValueError, match=r"has diffshadow 0\.0\.1"):
            study.run_sweep(load_sweep(Path("s.yaml")), console=quiet(), scheduler=cluster.address)


@pytest.mark.exhaustive
def test_a_worker_with_other_sources_is_refused_by_both_hashes(tmp_path):
    """Of the same version. A comment suffices."""
    here = own_code()
    with elsewhere(tmp_path) as cluster:
        cluster.start(change="# tripled\n")
        cluster.wait_for(1)
        with pytest.raises(
            ValueError, match=rf"expected diffshadow {here.version} with {here.hash}, as here"
        ) as caught:
            study.run_sweep(load_sweep(Path("s.yaml")), console=quiet(), scheduler=cluster.address)
        said = str(caught.value)
        (there,) = re.findall(r"has other code of diffshadow \S+, whose sources have the hash ([0-9a-f]{12});", said)
        assert there != here.hash


# Its package lacks what it needs.
LACKING = """
import sys

class Lacking:
    def find_spec(self, name, path=None, target=None):
        if name == "optimistix":
            raise ModuleNotFoundError("No module named 'optimistix'")

sys.meta_path.insert(0, Lacking())
"""


@pytest.mark.exhaustive
def test_a_worker_that_cannot_import_the_package_is_named_with_its_reason(tmp_path):
    """When the sweep starts, and when it joins later, after the first one is lost."""
    sweep = load_sweep(Path("s.yaml"), ["sweep.repeats=200"])
    said = r"worker at tcp://\S+ cannot import diffshadow \S+ \(ModuleNotFoundError: No module named 'optimistix'\)"
    with elsewhere(tmp_path) as cluster:
        cluster.start(site=LACKING)
        cluster.wait_for(1)
        with pytest.raises(ValueError, match=said):
            study.run_sweep(sweep, console=quiet(), scheduler=cluster.address)
    shutil.rmtree(tmp_path / "worker0")
    with elsewhere(tmp_path, 1, QUICK.format(seconds=0.05)) as cluster:
        folder = Path("runs/s-sweep").absolute()

        def replace() -> None:
            until(lambda: len(list(folder.glob("runs/*/result.json"))) >= 5)
            cluster._workers[0].send_signal(signal.SIGKILL)
            cluster.start(site=LACKING)

        thread = threading.Thread(target=replace)
        thread.start()
        with pytest.raises(ValueError, match=f"{said}|3 Dask workers died as they were given work"):
            study.run_sweep(sweep, console=quiet(), scheduler=cluster.address)
        thread.join()


def test_the_hash_of_code_is_of_its_sources_wherever_they_are(tmp_path):
    """Asked as a worker is, which has nothing of this package; of a clone, of a wheel and of changed code."""

    def asked(name: str, ends: str = "\n", value: int = 1, **files: str) -> tuple[str, str, str]:
        root = tmp_path / name / "diffshadow"
        (root / "settings").mkdir(parents=True)
        for file, text in {"__init__.py": "", "settings/__init__.py": f"A = {value}{ends}", **files}.items():
            (root / file).write_bytes(text.encode())
        made = tmp_path / name / "diffshadow-0.2.0.dist-info"
        made.mkdir()
        (made / "METADATA").write_text("Metadata-Version: 2.1\nName: diffshadow\nVersion: 0.2.0\n")
        command = [sys.executable, "-S", "-c", f"print(repr(eval({asked_of(known)!r})))"]
        done = subprocess.run(command, env={"PYTHONPATH": str(root.parent)}, capture_output=True, text=True, check=True)
        return ast.literal_eval(done.stdout)

    known = "none"
    version, plain, fault = asked("clone")
    assert (version, len(plain), fault) == ("0.2.0", 12, "")
    assert asked("windows", "\r\n")[1] == asked("compiled", **{"settings/a.pyc": "x", "settings/b.md": "y"})[1] == plain
    assert plain not in {
        asked("changed", value=3)[1],
        asked("more", **{"a.py": ""})[1],
        asked("rule", **{"a.json": "{}"})[1],
    }
    # What has the same sources is imported.
    known = plain
    _, same, fault = asked("same")
    assert (same, fault) == (plain, "ModuleNotFoundError: No module named 'diffshadow.study'")


def test_how_the_code_of_a_worker_differs_is_said_with_both():
    here = Code("0.2.0", "aaaa")
    assert _pool._difference(here, here) is None
    for there, said in (
        (Code("", ""), "does not have diffshadow; expected 0.2.0"),
        (Code("0.1.0", "bbbb"), "has diffshadow 0.1.0; expected 0.2.0, as here: install it there (pip install"),
        (Code("0.1.0", "bbbb"), "(the hash of its sources is bbbb, and aaaa here)"),
        (Code("0.2.0", "bbbb"), "has other code of diffshadow 0.2.0, whose sources have the hash bbbb; expected"),
        (Code("0.2.0", "bbbb"), "expected diffshadow 0.2.0 with aaaa, as here: install the same code there"),
        (Code("0.2.0", "aaaa", "ImportError: no"), "cannot import diffshadow 0.2.0 (ImportError: no); expected"),
        (Code("0.2.0", "", "No module named 'diffshadow'"), "cannot import diffshadow 0.2.0 (No module named"),
    ):
        assert said in str(_pool._difference(there, here))


class Dying:
    """A client whose workers die before they can answer."""

    def __init__(self):
        self.asked = 0

    def nthreads(self):
        return {f"tcp://a:{self.asked}": 1}

    def run(self, function, *arguments, workers, on_error):
        self.asked += 1
        return {address: OSError("closed") for address in workers}


def test_workers_that_die_as_they_join_end_the_sweep():
    cluster = _pool.OnCluster(Dying())
    cluster.check_versions()
    cluster.check_versions()
    with pytest.raises(ValueError, match="3 Dask workers died as they were given work, the last at tcp://a:2"):
        cluster.check_versions()


def test_it_is_said_that_a_scheduler_has_no_workers_and_the_wait_ends(monkeypatch):
    monkeypatch.setattr(_pool, "_SAID_AFTER", 0.15)
    monkeypatch.setattr(_pool, "_WORKERS_TIMEOUT", 0.5)
    none, said = SimpleNamespace(nthreads=dict), []
    with pytest.raises(ValueError, match=r"scheduler at tcp://a:1 has no workers after 0\.5 seconds; expected"):
        _pool.OnCluster(none, say=said.append).wait_for_workers("tcp://a:1")
    (text,) = said
    assert text.startswith("waiting for a worker of the Dask scheduler at tcp://a:1, which has none yet: start it with")

    def interrupt():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        _pool.OnCluster(none, interrupt).wait_for_workers("tcp://a:1")
    _pool.OnCluster(SimpleNamespace(nthreads=lambda: {"tcp://a:2": 1})).wait_for_workers("tcp://a:1")


def _only_again(check: Callable[..., None]) -> Callable[..., None]:
    return lambda self, again=False: check(self, again=True) if again else None


@pytest.mark.exhaustive
def test_a_worker_may_be_lost_and_another_may_join(tmp_path):
    def lose(cluster: Elsewhere, folder: Path) -> None:
        first = cluster._workers[0]
        until(lambda: len(list(folder.glob("runs/*/result.json"))) >= 20)
        first.send_signal(signal.SIGKILL)
        cluster.start()

    there, here = both(tmp_path, ["sweep.repeats=100"], during=lose, workers=2)
    assert there == here
    assert sum(b'"status": "ok"' in content for content in there.values()) == 200


@pytest.mark.exhaustive
@pytest.mark.parametrize("is_package", [False, True], ids=["file", "package"])
def test_a_user_s_filter_is_sent_along(tmp_path, is_package, monkeypatch):
    name = "own_package" if is_package else "own_file"
    if is_package:
        Path(name).mkdir()
        Path(name, "_corners.py").write_text(FILTER)
        Path(name, "__init__.py").write_text("from ._corners import Corners")
    else:
        Path(f"{name}.py").write_text(FILTER)
    monkeypatch.setattr(sys, "path", list(sys.path))
    overrides = [f"filter={{type: '{name}:Corners', radius: 2}}", "sweep.repeats=2"]
    there, here = both(tmp_path, overrides)
    assert there == here
    assert sum(b'"status": "ok"' in content for content in there.values()) == 4


@pytest.mark.exhaustive
def test_a_user_s_filter_that_workers_cannot_load_is_refused(tmp_path, monkeypatch):
    Path("own_helper.py").write_text("")
    Path("own_parted.py").write_text("import own_helper" + FILTER)
    monkeypatch.setattr(sys, "path", list(sys.path))
    sweep = load_sweep(Path("s.yaml"), ["filter={type: 'own_parted:Corners', radius: 2}"])
    with elsewhere(tmp_path, 1) as cluster, pytest.raises(ValueError, match=r"cannot load .*own_parted\.py: No module"):
        study.run_sweep(sweep, console=quiet(), scheduler=cluster.address)
