# %% [markdown]
# # The landscape of bias and radius, and the way through it
#
# See how a fit finds a bias where the error has no gradient. Under the hard compare of a shadow map, the error is a
# landscape of cliffs and plateaus. A fit therefore uses a soft compare, whose width shrinks from phase to phase, and
# walks down the landscape of each phase in turn. This notebook draws these landscapes, the solver's path on each, and
# the landscape of the hard compare, which judges the result.

# %% tags=["hide-input"]
import os

import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm

from diffshadow import config, fit, metrics, raster, reference, setup, shadow

setup()  # before the first array
plt.style.use("diffshadow.mplstyle")
SMALL = bool(os.environ.get("DIFFSHADOW_SMALL"))  # a quick run, for tests
PIXELS, TEXELS, RAYS, GRID = (48, 96, 16, 7) if SMALL else (128, 160, 128, 25)
NAMES = ("bias.constant", "filter.radius")

# %% [markdown]
# **The scene** is the one of `configs/bias_landscape.yaml`: a torus knot and a box on a floor, under a sun of 2°
# radius, with a coarse map.

# %%
scene = config.build_scene(
    config.load_config(
        "../configs/bias_landscape.yaml", [f"scene.camera.resolution=[{PIXELS}, {PIXELS}]", "scene.light.angular_radius=2"]
    )
)
truth = reference.trace_visibility(scene, samples=RAYS)
technique = shadow.ShadowMapping(
    shadow.RandomDisk(1.0, shadow.stratified((4, 4))),
    shadow.Bias(constant=0.3, slope=0.5, normal_offset=0.0),
    map=shadow.MapSettings((TEXELS, TEXELS)),
)
problem = fit.TechniqueProblem.of(scene, technique, truth)
shadow_map, surface, mask = problem.shadow_map, problem.surface, problem.mask

# %% [markdown]
# **The fit** starts from almost no bias and a wide disk. `result.history` has every evaluation of the loss.

# %%
anneal = fit.Anneal(start=2.0, end=0.1, phases=3)
parameters = [fit.Parameter(NAMES[0], 0.3, 0.0, 12.0), fit.Parameter(NAMES[1], 4.0, 0.0, 6.0)]  # texels
result = fit.fit(problem, parameters, solver=fit.Solver(max_steps=12), anneal=anneal)
for number, phase in enumerate(result.phases):
    bias, radius = phase.values
    print(
        f"phase {number}, {phase.width:4.2f} texels wide, {phase.steps:2} steps to bias {bias:.2f}, radius {radius:.2f}: "
        f"RMSE {phase.hard_loss**0.5:.4f} by the hard compare"
    )
print(f"best: phase {result.chosen}")

# %% [markdown]
# **The landscapes** show the RMSE at every point of a grid, under each phase's soft compare and under the hard compare.

# %%
@eqx.filter_jit
def visibility(compare, values):
    technique = fit.with_values(result.technique, NAMES, values)
    return eqx.tree_at(lambda t: t.compare, technique, compare).visibility(shadow_map, surface)


biases, radii = (np.linspace(p.lower, p.upper, GRID) for p in parameters)
compares = {f"soft, {width:.2g} texels": shadow.SoftCompare(width) for width in anneal.widths}
compares["hard"] = shadow.HardCompare()
seen = np.asarray(mask)
rmse = lambda image: float(np.sqrt(np.mean((np.asarray(image) - truth.visibility)[seen] ** 2)))
landscape = {
    name: np.array([[rmse(visibility(compare, jnp.array([b, r], jnp.float32))) for b in biases] for r in radii])
    for name, compare in compares.items()
}

# %% tags=["picture"]
figure, axes = plt.subplots(2, 2, figsize=(9.2, 7.2), sharex=True, sharey=True)
norm = LogNorm(min(z.min() for z in landscape.values()), max(z.max() for z in landscape.values()))
steps = {name: [s.values for s in result.history if s.phase == i] for i, name in enumerate(compares)}
start = [p.initial for p in parameters]
for number, (ax, (name, z)) in enumerate(zip(axes.flat, landscape.items())):
    shown = ax.pcolormesh(biases, radii, z, norm=norm, cmap="cividis_r", shading="nearest", rasterized=True)
    ax.contour(biases, radii, z, levels=np.geomspace(norm.vmin, norm.vmax, 14), colors="k", linewidths=0.4, alpha=0.4)
    ax.set_title(f"{name} compare")
    if name != "hard":
        path = np.array([start if number == 0 else result.phases[number - 1].values, *steps[name]])
        ax.plot(*path.T, color="white", linewidth=3)
        ax.plot(*path.T, ".-", color="#d55e00", linewidth=1.3, markersize=5, label="solver's evaluations")
        ax.plot(*path[0], "D", color="#d55e00", markeredgecolor="white", markersize=7, label="phase's start")
    else:
        ends = np.array([start, *(phase.values for phase in result.phases)])
        ax.plot(*ends.T, "o--", color="#d55e00", markeredgecolor="white", markersize=6, label="start, and phases' ends")
        row, column = np.unravel_index(z.argmin(), z.shape)
        ax.plot(biases[column], radii[row], "kx", markersize=8, label="grid's best")
    ax.plot(*result.fitted.values(), "*", color="#d55e00", markeredgecolor="white", markersize=13, label="result")
    ax.legend(loc="upper right", frameon=True, framealpha=0.85)
for ax in axes[1]:
    ax.set_xlabel("constant bias [texels]")
for ax in axes[:, 0]:
    ax.set_ylabel("radius of the disk [texels]")
bar = figure.colorbar(shown, ax=axes, shrink=0.7, label="RMSE [visibility]")

# %% [markdown]
# **Does the grid have a better point?** A ratio below one means that the fit's result, which lies between points of the
# grid, is better than all of them.

# %%
found = rmse(visibility(shadow.HardCompare(), jnp.array(list(result.fitted.values()), jnp.float32)))
best = landscape["hard"].min()
before = rmse(visibility(shadow.HardCompare(), jnp.array(start, jnp.float32)))
print(f"RMSE: start {before:.4f}, fit {found:.4f}, best of {GRID}² points {best:.4f}, ratio {found / best:.3f}")
print(f"noise of the reference: {truth.noise_floor:.4f}")
evaluations = len(result.history)
print(f"{evaluations} evaluations by the fit, {GRID * GRID} by the grid")
assert found < 1.05 * best

# %% [markdown]
# **Acne against leaks.** At the fitted radius, more bias gives less false shadow and more false light.

# %%
rates = []
for bias in biases:
    image = visibility(shadow.HardCompare(), jnp.array([bias, result.fitted["filter.radius"]], jnp.float32))
    rates.append([rate(image, truth.visibility, mask) for rate in (metrics.false_shadow_rate, metrics.false_light_rate)])
figure, ax = plt.subplots(figsize=(5.6, 3.2))
least = 0.5 / seen.sum()  # half a pixel: where nought is drawn
ax.semilogy(biases, np.maximum(rates, least), "o-", label=["false shadow (acne)", "false light (leaks)"])
ax.axvline(result.fitted["bias.constant"], color="k", linestyle=":", label="fitted bias")
ax.set(xlabel="constant bias [texels]", ylabel="share of pixels")
ax.grid(True)
ax.legend()
