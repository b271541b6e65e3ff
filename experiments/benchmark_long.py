"""How the memory of a long process grows with the number of its fits.

    python experiments/benchmark_long.py
    python experiments/benchmark_long.py --shapes changing --fits 100 --json long.json

Each kind is a process of its own, with an empty cache, that calls `fit.fit` again and again. The scene is a sphere on a
plane, the fit Levenberg-Marquardt with four steps in two phases, of a bias and a radius:

- `equal`: images of 48 x 48 pixels, maps of 64 x 64 texels.
- `changing`: images and maps of sides that no earlier fit had, from 32 pixels and 64 texels.

The columns are the most of each 25 fits, measured after each fit: resident memory, memory mappings (Linux allows a
process 65,530), and the median of the seconds of a fit, with its reference. Needs Linux.
"""

import argparse
import json
import statistics
import time
from collections.abc import Sequence
from itertools import batched
from pathlib import Path
from typing import Any

from _child import rows_of_child
from benchmark_raster import machine, positive
from rich.table import Table

import diffshadow
from diffshadow import fit, geometry, reference, shadow
from diffshadow.console import Console

KINDS = ("equal", "changing")
# The fits of a row, and the sides that change.
_ROW, _SIDES = 25, 33


def sizes(kind: str, number: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """The height and width of the image in pixels, and of the map in texels."""
    if kind == "equal":
        return (48, 48), (64, 64)
    more, others = number % _SIDES, number // _SIDES
    return (32 + more, 32 + others), (64 + more, 64 + others)


def fit_once(image: tuple[int, int], texels: tuple[int, int]) -> None:
    """Traces a reference, and fits to it."""
    ball = geometry.drop_to_ground(geometry.library_mesh("sphere", radius=0.5, subdivisions=2))
    meshes = [ball, geometry.library_mesh("plane", size=4.0)]
    camera = geometry.PinholeCamera((1.6, 2.2, 2.6), (0.0, 0.4, 0.0), fov_y=45.0, resolution=image)
    light = geometry.DirectionalLight.around((0.5, -1.0, -0.3), geometry.merge(meshes).vertices, angular_radius=2.0)
    scene = geometry.Scene(meshes, camera, light)
    technique = shadow.ShadowMapping(
        shadow.RandomDisk(2.0, shadow.stratified(8, 4)), shadow.Bias(constant=1.0), map=shadow.MapSettings(texels)
    )
    problem = fit.TechniqueProblem.of(scene, technique, reference.trace_visibility(scene, samples=4))
    bounds = [fit.Parameter("bias.constant", 1.0, 0.0, 30.0), fit.Parameter("filter.radius", 2.0, 0.0, 8.0)]
    fit.fit(problem, bounds, solver=fit.Solver(max_steps=4), anneal=fit.Anneal(phases=2))


def memory() -> dict[str, float]:
    """This process's resident memory in MiB, and its mappings."""
    status = Path("/proc/self/status").read_text()
    resident = next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS"))
    return {"resident": int(resident) / 2**10, "mappings": Path("/proc/self/maps").read_bytes().count(b"\n")}


def measure(kind: str, fits: int) -> None:
    """Fits in this process, and prints the memory after each fit as a line of JSON."""
    diffshadow.setup(progress=False)
    for number in range(fits):
        began = time.perf_counter()
        fit_once(*sizes(kind, number))
        print(json.dumps({**memory(), "seconds": time.perf_counter() - began}), flush=True)


def table_of(kind: str, rows: Sequence[dict[str, Any]]) -> Table:
    """The most memory and the median time of each 25 fits."""
    table = Table("fits", "resident [MiB]", "mappings", "a fit [s]", title=f"{kind} shapes", title_justify="left")
    done = 0
    for some in batched(rows, _ROW):
        done += len(some)
        most = [max(row[name] for row in some) for name in ("resident", "mappings")]
        seconds = statistics.median(row["seconds"] for row in some)
        table.add_row(f"{done:,}", *(f"{number:,.0f}" for number in most), f"{seconds:.2f}")
    return table


def main(argv: Sequence[str] | None = None) -> None:
    """Measures, and prints a table for each kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shapes", nargs="+", choices=KINDS, default=KINDS, help="which kinds")
    parser.add_argument("--fits", type=positive, default=300, help="fits of each process")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.child:
        measure(options.shapes[0], options.fits)
        return
    console, about = Console(), machine()
    console.print(", ".join(f"{name} {value}" for name, value in about.items()))
    found = {}
    for kind in options.shapes:
        case, fits = f"the process with fits of {kind} shapes", str(options.fits)
        found[kind] = rows_of_child(__file__, case, "--shapes", kind, "--fits", fits)
        console.print(table_of(kind, found[kind]))
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": about, **found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
