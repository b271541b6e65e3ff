"""Figures of how a fit moved lights and meshes. This module loads Matplotlib, so import it only to draw figures."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from ... import fit
from ..._types import HostArray
from ...geometry import AbstractLight, Mesh, Scene, face_colours
from .. import style

Track = Float[HostArray, "n 3"]
# The margin around the drawing, as a fraction of its extent.
_MARGIN = 0.06


def write_paths(path: Path, scene: Scene, result: fit.FitResult, truth: Mapping[str, float]) -> None:
    """Draws the scene from above and from the side, with the path of each light and mesh from start to end.

    A light at infinity is drawn on a dome around the scene, in its direction. `truth` has the known values, by the
    names of parameters.
    """
    listed = lambda values: np.asarray([values[p.name] for p in result.parameters])
    values = np.stack([listed(result.initial), *_steps_of_best(result), listed(result.fitted)])
    offsets, names = np.asarray([p.offset for p in result.parameters]), tuple(p.where for p in result.parameters)
    places = lambda values, key: np.stack(_places(result, names, values - offsets, key, scene))
    tracks = {key: places(values, key) for key in _movers(names, result)}
    marks = {}
    if truth:
        known = listed({**result.fitted, **truth})[None]
        marks = {key: places(known, key)[0] for key in tracks}
    figure, axes = style.figure(9.6, 4.6, 1, 2)
    for each, (across, up), title in zip(axes, ((0, 2), (0, 1)), ("From above", "From the side"), strict=True):
        _scene(each, scene.meshes, across, up)
        for number, (key, track) in enumerate(tracks.items()):
            _track(each, track, marks.get(key), across, up, style.CYCLE[number % len(style.CYCLE)], key)
        if up == 2:
            # Seen from above with +x to the right, +z points down.
            each.invert_yaxis()
        each.set_aspect("equal")
        style.chart(each, *(f"{'xyz'[axis]}{_from(scene.origin[axis])} [world units]" for axis in (across, up)))
        style.title(each, title)
    handles, labels = axes[0].get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    figure.legend(named.values(), named.keys(), fontsize=8, frameon=False, loc="outside lower center", ncols=6)
    style.save(figure, path)


def _steps_of_best(result: fit.FitResult) -> list[HostArray]:
    """The values at each step of the start that was continued."""
    initial = tuple(result.initial.values())
    firsts = {step.start: step.values for step in reversed(result.history)}
    best = min(firsts, key=lambda start: float(np.abs(np.subtract(firsts[start], initial)).max()), default=0)
    return [np.asarray(step.values) for step in result.history if step.start == best]


def _movers(names: Sequence[str], result: fit.FitResult) -> list[str]:
    """The lights and meshes that the fit moves, such as `lights.0`. Only lights with an image are included."""
    moved = dict.fromkeys(".".join(n.split(".")[:2]) for n in names if not n.startswith("technique."))
    return [key for key in moved if key.startswith("meshes.") or int(key.split(".")[1]) in _lights(result)]


def _lights(result: fit.FitResult) -> dict[int, AbstractLight]:
    """The lights of the fit's images, by index."""
    problems: tuple[Any, ...] = result.problems
    return {problem.index: problem.scene.light for problem in problems}


def _places(
    result: fit.FitResult, names: Sequence[str], values: Any, key: str, scene: Scene
) -> list[Float[HostArray, "3"]]:
    """The position of the light or mesh `key` for each of `values` (n, p), relative to the scene's origin."""
    kind, index = key.split(".")
    arrangement, lights = result.arrangement, _lights(result)
    everything = scene.mesh.bounds
    middle, reach = everything.mean(axis=0), jnp.linalg.norm(everything[1] - everything[0]) / 2

    @eqx.filter_jit
    def place(values: Any) -> Any:
        moved = fit.with_values(arrangement, names, values)
        if kind == "meshes":
            mesh: Mesh = moved.meshes[int(index)].placed(scene.meshes[int(index)])
            return mesh.bounds.mean(axis=0)
        pose = moved.lights[int(index)]
        if pose.position is None:
            return middle + reach * lights[int(index)].at(pose).towards(middle[None])[0]
        return pose.place

    return [np.asarray(place(jnp.asarray(each, jnp.float32))) for each in values]


def _scene(axes: Axes, meshes: Sequence[Mesh], across: int, up: int) -> None:
    corners = np.concatenate([np.asarray(mesh.vertices)[np.asarray(mesh.faces)] for mesh in meshes])
    colours = np.concatenate([face_colours(mesh) for mesh in meshes])
    # Drawn from back to front.
    order = np.argsort(corners.mean(axis=1)[:, 3 - across - up])
    faces = corners[order][:, :, [across, up]]
    axes.add_collection(PolyCollection(list(faces), facecolors=colours[order], edgecolors="none", alpha=0.55))
    axes.autoscale_view()


def _track(axes: Axes, track: Track, truth: HostArray | None, across: int, up: int, colour: str, key: str) -> None:
    x, y = track[:, across], track[:, up]
    axes.plot(x, y, color=colour, linewidth=1.4, marker=".", markersize=4, label=f"{_label(key)}, step by step")
    dot: dict[str, Any] = {"color": colour, "marker": "o", "linestyle": "none"}
    axes.plot(x[0], y[0], markersize=8, markerfacecolor=style.PAPER, label="start", **dot)
    axes.plot(x[-1], y[-1], markersize=7, label="end", **dot)
    if truth is not None:
        cross: dict[str, Any] = {"color": style.INK, "marker": "+", "linestyle": "none"}
        axes.plot(truth[across], truth[up], markersize=13, markeredgewidth=1.6, label="truth", **cross)
    axes.margins(_MARGIN)


def _from(origin: float) -> str:
    """The origin of a coordinate, for an axis label."""
    return f" {'-' if origin > 0 else '+'} {abs(origin):.15g}" if origin else ""


def _label(key: str) -> str:
    kind, index = key.split(".")
    return f"{'light' if kind == 'lights' else 'mesh'} {index}"
