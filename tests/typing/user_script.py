"""A script of a user, as `mypy --strict` reads it: no name of the package is untyped or `Any` by accident."""

from pathlib import Path
from typing import reveal_type

import numpy as np

import diffshadow
from diffshadow import fit, geometry, io, reference, shadow, study

diffshadow.setup(progress=False)
knot, floor = geometry.library_mesh("torus"), geometry.library_mesh("plane", size=6.0)
camera = geometry.PinholeCamera(eye=(3.0, 2.0, 3.0), target=(0.0, 0.5, 0.0), resolution=(128, 128))
sun = geometry.DirectionalLight.around((-1.0, -2.0, -0.5), geometry.merge([knot, floor]).vertices)
scene = geometry.Scene([knot, floor], camera, sun)
truth = reference.trace_visibility(scene, samples=64)
settings = shadow.MapSettings((256, 256))
technique = shadow.ShadowMapping(shadow.PercentageCloser(2.0), shadow.Bias(constant=1.0), map=settings)
problem = fit.TechniqueProblem.of(scene, technique, truth)
bounds = [fit.Parameter("bias.constant", 1.0, 0.0, 10.0), fit.Parameter("filter.radius", 2.0, 0.0, 8.0)]


def show(step: fit.Step) -> None:
    print(step.phase, step.loss)


result = fit.fit(problem, bounds, solver=fit.Solver("adam", 20), on_step=show)
values: dict[str, float] = result.fitted
folder: Path = study.save_fit(result, "runs/mine")
io.write_gltf("fitted.glb", scene, extras=values)
image = np.asarray(result.technique.visibility(problem.shadow_map, problem.surface))
reveal_type(result.fitted)
reveal_type(truth.visibility)
reveal_type(camera.fov_y)
reveal_type(shadow.Bias(constant=1.0).constant)
reveal_type(camera.view().world_to_eye)
