# %% [markdown]
# # A light from its shadow
#
# This notebook finds the sun's direction from one image of a shadow. At every step, the fit draws map and shadow again.
# The motion of the shadow's outline has a gradient, because the map stores where, within a texel, casters end. The fit
# compares images under a wide blur first, where the error is a smooth function of the direction, and then under
# narrower blurs.

# %% tags=["hide-input"]
import dataclasses
import os

import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm

from diffshadow import config, fit, setup, study

setup()  # before the first array
plt.style.use("diffshadow.mplstyle")
SMALL = bool(os.environ.get("DIFFSHADOW_SMALL"))  # a quick run, for tests
PIXELS, TEXELS, STEPS, GRID = (48, 96, 8, 5) if SMALL else (128, 256, 20, 15)

# %% [markdown]
# **Given**: the scene of `configs/fit_light_sun.yaml`, and its ray-traced shadow. **Wanted**: the sun's azimuth and
# elevation, within wide bounds. The start is about 20° off.

# %%
settings = config.load_config(
    "../configs/fit_light_sun.yaml",
    [
        f"scene.camera.resolution=[{PIXELS}, {PIXELS}]",
        f"shadow_map.resolution=[{TEXELS}, {TEXELS}]",
        f"fit.solver.max_steps={STEPS}",
    ],
)
scene = config.build_scene(settings)
plan = config.build_fit(settings, scene)
problems = study.pose_problems(settings, plan, scene)
for p in plan.parameters:
    print(f"{p.name:22} starts at {p.initial:.0f}, within {p.lower:.0f} to {p.upper:.0f} {p.unit}")

# %% [markdown]
# **Fit.**

# %%
result = fit.fit(problems, plan.parameters, solver=plan.solver, anneal=plan.anneal)
deviations = result.precision.deviations
for name, value in result.fitted.items():
    truth = plan.truth[name]
    print(
        f"{name:22} {result.initial[name]:7.2f} to {value:7.3f}, truth {truth:5.1f}: "
        f"error {value - truth:+.3f}, deviation {deviations[name]:.3f} degrees"
    )
for phase in result.phases:
    print(f"blur {phase.blur:2.0f} pixels: {phase.steps:2} steps, RMSE {phase.hard_loss**0.5:.4f} without the blur")

# %% [markdown]
# The *deviation* is the standard deviation of the value, estimated from the pixels' residuals to first order. The
# estimate accounts for the correlation of neighbouring pixels along an outline. `experiments/coverage.py` measures how
# often the truth lies within it.

# %% tags=["picture"]
problem, where = result.problems[0], [p.where for p in plan.parameters]


@eqx.filter_jit
def at(problem, values):
    """The shadow, and its difference from the truth, with the sun at `values`."""
    arrangement = fit.with_values(problem.arrangement, where, values)
    shadow_map, surface = problem.draw(arrangement)
    return arrangement.technique.visibility(shadow_map, surface), problem.difference(arrangement)


seen = np.asarray(problem.weight > 0)
values = lambda chosen: jnp.array(list(chosen.values()), jnp.float32)
start, end = at(problem, values(result.initial)), at(problem, values(result.fitted))
figure, axes = plt.subplots(1, 4, figsize=(12.4, 3.2), sharey=True)
shadows = {"truth": problem.reference, "start": start[0], "fitted": end[0]}
for ax, (name, image) in zip(axes, shadows.items()):
    bright = ax.imshow(np.where(seen, image, np.nan), vmin=0, vmax=1)
    ax.set_title(name)
shown = axes[3].imshow(np.where(seen, end[1], np.nan), cmap="PuOr", vmin=-1, vmax=1)
axes[3].set_title("fitted less truth")
for ax in axes:
    ax.set(xlabel="x [pixels]", facecolor="#d5dce4")
axes[0].set_ylabel("y [pixels]")
bars = figure.colorbar(bright, ax=axes[:3], shrink=0.7, label="visibility"), figure.colorbar(shown, ax=axes[3], shrink=0.7)

# %% [markdown]
# **The landscape** shows the RMSE of blurred differences over both angles, under the first blur and the last blur, with
# the fit's evaluations. The fit minimises this RMSE.

# %%
figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), sharey=True)
azimuth, elevation = (np.linspace(p.lower, p.upper, GRID) for p in plan.parameters)
differences = [[at(problem, jnp.array([a, e], jnp.float32))[1] for a in azimuth] for e in elevation]
for ax, number in zip(axes, (0, len(result.phases) - 1)):
    under = dataclasses.replace(problem, blur=result.phases[number].blur)
    mean_square = lambda difference: float(jnp.sum(under.compared(difference) ** 2) / under.count)
    rmse = np.sqrt([[mean_square(difference) for difference in row] for row in differences])
    norm = LogNorm(rmse.min(), rmse.max())
    shown = ax.pcolormesh(azimuth, elevation, rmse, norm=norm, cmap="cividis_r", shading="nearest", rasterized=True)
    figure.colorbar(shown, ax=ax, shrink=0.8, label="RMSE, blurred [visibility]")
    path = np.array([step.values for step in result.history if step.phase == number])
    ax.plot(*path.T, color="white", linewidth=3)
    ax.plot(*path.T, ".-", color="#d55e00", linewidth=1.3, markersize=5, label="fit's evaluations")
    ax.plot(*path[0], "D", color="#d55e00", markeredgecolor="white", markersize=7, label="first of them")
    ax.plot(*plan.truth.values(), "kx", markersize=9, markeredgewidth=2, label="truth")
    ax.plot(*result.fitted.values(), "*", color="#d55e00", markeredgecolor="white", markersize=12, label="fitted")
    ax.set(title=f"blur of {result.phases[number].blur:.0f} pixels", xlabel="azimuth [degrees]")
    ax.legend(loc="lower right", frameon=True, framealpha=0.85)
axes[0].set_ylabel("elevation [degrees]")

# %%
error = lambda values: max(abs(values[name] - truth) for name, truth in plan.truth.items())
worst = error(result.fitted)
print(f"greatest error: {worst:.3f} degrees")
assert worst < (0.5 * error(result.initial) if SMALL else 0.5)
