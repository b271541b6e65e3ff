"""The evaluation of a fit of a shape: a compiled program, whose data are arguments.

Meshes are padded to the size of the finest mesh, so that all phases, and all meshes of similar size, share the program.
"""

import dataclasses
import threading
from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from .._arithmetic import as_array, as_float
from .._padding import shared_mesh_size, shared_size
from .._types import HostArray
from ..geometry import AbstractLight, Edges, Mesh
from ._moving_lights import MovingLights
from ._programs import compiled
from .problems import ShapeProblem, ShapeView, of_one_structure, together
from .problems._aligned import are_aligned, may_be_aligned
from .problems._shape import Evaluation, Sight, evaluate, mirror_partners, mirrored, sights

# When this fraction of the memory for crossings is used, a larger program is compiled in parallel to the fit.
_NEARLY_FULL = 0.85


class Level(NamedTuple):
    """A mesh of the common size of a fit's meshes. `faces` and `edges` are padded; `own_faces` are not."""

    start: Float[HostArray, "v 3"]
    own_faces: Int[HostArray, "f 3"]
    free: Bool[HostArray, " v"]
    faces: Any
    edges: Edges
    partner: Int[HostArray, " v"] | None


class ShapeProgram:
    """A problem's views and its compiled program, which evaluates the loss of meshes that are padded to one size."""

    def __init__(self, problem: ShapeProblem, splits: int = 0):
        """**Arguments:** `splits`: the number of times that the fit splits the triangles."""
        self.problem = problem
        groups = of_one_structure(problem.views)
        self.groups: list[ShapeView] = [together(group) for group in groups]
        order = {id(view): number for number, view in enumerate(problem.views)}
        self.order = np.argsort([order[id(view)] for group in groups for view in group])
        vertices = np.asarray(problem.mesh.vertices, np.float64)
        # All meshes are padded to the size of the finest mesh.
        edges = len(Edges.of(problem.mesh).vertices)
        count, faces = len(vertices), len(problem.mesh.faces)
        for _ in range(splits):
            count, edges, faces = count + edges, 2 * edges + 3 * faces, 4 * faces
        self.padding = shared_mesh_size(faces, count), shared_size(edges)
        self.more: threading.Thread | None = None
        self.lights = MovingLights.of(self.groups, vertices[np.asarray(problem.free)].mean(axis=0))
        self.sights = sights(self.groups)
        fixed = not self.lights.move and may_be_aligned(problem.technique)
        self.receivers = [
            sight.receivers if fixed and are_aligned(sight.receivers, problem.technique) else None
            for sight in self.sights
        ]

    def found_sights(self) -> list[Sight]:
        """The part of each view's screen that the view's light sees.

        **Raises** `ValueError` for a light that reaches no pixel.
        """
        numbers = self._of_views([[(sight, i) for i in range(len(sight.reached))] for sight in self.sights])
        found = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], sight) for sight, i in numbers]
        reached = [bool(sight.reached.any()) for sight in found]
        if not all(reached):
            raise ValueError(
                f"the light of view {reached.index(False)} reaches none of the pixels that count; expected a surface "
                "in the light's shadow map that faces the light: move the light or the surface, or make the "
                "map's extent larger"
            )
        return found

    def seen(
        self,
        vertices: Float[HostArray, "v 3"],
        faces: Int[HostArray, "f 3"],
        lights: Float[HostArray, " l"],
        crossings: int,
    ) -> list[Float[HostArray, "h w"]]:
        """The mesh's visibility image in each view."""
        level = self.level(vertices, faces, np.ones(len(vertices), bool))
        return self.images(self.evaluate(level, vertices, lights, 0.0, crossings)[0])

    def level(
        self, vertices: Float[HostArray, "v 3"], faces: Int[HostArray, "f 3"], free: Bool[HostArray, " v"]
    ) -> Level:
        mesh, symmetry = Mesh(vertices, faces), self.problem.symmetry
        (count, _), rows = self.padding
        edges = dataclasses.replace(Edges.of(mesh).padded(count, rows), is_closed=True)
        partner = None if symmetry is None else mirror_partners(vertices, symmetry)
        free = free if partner is None else free & free[partner]
        return Level(vertices, faces, free, mesh.padded(self.padding[0]).faces, edges, partner)

    def mirrored(self, level: Level, vertices: Float[HostArray, "v 3"]) -> Float[HostArray, "v 3"]:
        """The vertices, or the mean of the vertices and their mirror images."""
        if level.partner is None or self.problem.symmetry is None:
            return vertices
        return (vertices + mirrored(vertices, self.problem.symmetry)[level.partner]) / 2

    def mirrored_gradient(self, level: Level, gradient: Float[HostArray, "v 3"]) -> Float[HostArray, "v 3"]:
        if level.partner is None or self.problem.symmetry is None:
            return gradient
        *normal, _ = self.problem.symmetry
        return (gradient + mirrored(gradient, (*normal, 0.0))[level.partner]) / 2

    def evaluate(
        self,
        level: Level,
        vertices: Float[HostArray, "v 3"],
        lights: Float[HostArray, " l"],
        blur: float,
        crossings: int,
    ) -> tuple[Evaluation, int]:
        """The loss, and the number of crossings with memory.

        Memory is doubled when it is full. Before that, a thread compiles the program for the larger memory while the
        fit continues.
        """
        (_, count), _ = self.padding
        padded = np.concatenate([vertices, np.broadcast_to(vertices[:1], (count - len(vertices), 3))])
        views = self.groups, self.receivers, self.lights.poses(lights)
        given = as_float(padded), level.faces, level.edges, *views, self.problem.technique, as_float(blur)
        run = lambda crossings: compiled(evaluate, (*given, crossings))(*given, crossings)
        while True:
            found = run(crossings)
            needed = int(found.crossings)
            if needed > _NEARLY_FULL * crossings and self.more is None:
                self.more = threading.Thread(target=run, args=(2 * crossings,), daemon=True)
                self.more.start()
            if needed <= crossings:
                return found, crossings
            self.join()
            self.more, crossings = None, 2 * crossings

    def join(self) -> None:
        """Waits for the compiling thread."""
        if self.more is not None:
            self.more.join()

    def lit(self, numbers: Float[HostArray, " l"]) -> list[AbstractLight]:
        """The light of each view."""
        groups = self.lights.lights(numbers)
        each = lambda lights, i: jax.tree.map(lambda leaf: as_array(np.asarray(leaf)[i]), lights)
        counts = [len(group.reference) for group in self.groups]
        return self._of_views(
            [[each(*at) for at in product([g], range(n))] for g, n in zip(groups, counts, strict=True)]
        )

    def images(self, found: Evaluation) -> list[Float[HostArray, "h w"]]:
        return self._of_views([np.asarray(image) for image in found.images])

    def _of_views(self, groups: Sequence[Any]) -> list[Any]:
        """The entries of each group's first axis, in the order of the problem's views."""
        every = [one for group in groups for one in group]
        return [every[number] for number in self.order]
