# %% [markdown]
# # First look: from a mesh to a fitted bias
#
# In ten cells of code, this notebook builds a scene, draws and ray-traces its shadow, and finds the best bias and
# filter radius. A shadow map needs a bias: too little gives acne, and too much detaches shadows from their casters
# (Peter-panning).

# %% tags=["hide-input"]
import os

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

from diffshadow import fit, geometry, metrics, raster, reference, setup, shadow

setup()  # before the first array
plt.style.use("diffshadow.mplstyle")
SMALL = bool(os.environ.get("DIFFSHADOW_SMALL"))  # a quick run, for tests
pixels, texels, rays = (48, 96, 16) if SMALL else (192, 512, 128)

# %% [markdown]
# **Meshes.** A torus knot that stands on a floor. The library has more, and `diffshadow.io` reads files.

# %%
knot = geometry.fit_to_size(geometry.library_mesh("torus_knot"), 1.0)  # longest side, world units
floor = geometry.library_mesh("plane", size=3.0)
meshes = [geometry.drop_to_ground(knot), floor]
print(f"{sum(len(mesh.faces) for mesh in meshes):,} triangles")

# %% [markdown]
# **Camera and light.** The sun is a disk of 2° radius, about seven times its true size, so that its shadows are soft.

# %%
camera = geometry.PinholeCamera(
    eye=(1.3, 1.4, 1.8), target=(0.1, 0.35, 0.0), fov_y=38.0, resolution=(pixels, pixels)
)
points = geometry.merge(meshes).vertices
light = geometry.DirectionalLight.around((0.5, -1.0, -0.3), points, angular_radius=2.0)
scene = geometry.Scene(meshes, camera, light)

# %% [markdown]
# **Technique.** We start with too small a bias and too narrow a disk of 16 taps.

# %%
technique = shadow.ShadowMapping(
    filter=shadow.RandomDisk(radius=1.0, pattern=shadow.stratified((4, 4))),
    bias=shadow.Bias(constant=0.2, slope=0.3, normal_offset=0.0),  # texels
    map=shadow.MapSettings(resolution=(texels, texels)),
)

# %% [markdown]
# **Two views.** The light's view is the shadow map, and the camera's view shows the receivers. Neither depends on bias
# or filter, so each is drawn once.

# %%
shadow_map = technique.prepare(scene)
surface = raster.draw_surface(scene.mesh, camera)
before = technique.visibility(shadow_map, surface)
print(f"{float(jnp.mean(shadow_map.depth < 1)):.0%} of the texels hold a surface")

# %% [markdown]
# **Truth.** The ray tracer, which shares no code with the shadow maps, sends rays to the whole disk of the sun.

# %%
truth = reference.trace_visibility(scene, samples=rays)
mask = np.asarray(technique.covered(shadow_map, surface)) & truth.mask
print(f"noise of the reference: RMSE {truth.noise_floor:.4f}")

# %%
figure, axes = plt.subplots(1, 3, figsize=(11, 3.6))
depth = np.where(shadow_map.depth < 1, shadow_map.depth, np.nan)
panels = {"shadow map: window depth": depth, "before: visibility": before, "ray traced: visibility": truth.visibility}
for ax, (title, image) in zip(axes, panels.items()):
    shown = ax.imshow(image, cmap="cividis_r" if "depth" in title else "gray")
    figure.colorbar(shown, ax=ax, shrink=0.8)
    ax.set_title(title)
    unit = "texels" if "depth" in title else "pixels"
    ax.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")

# %% [markdown]
# **Fit.** Levenberg-Marquardt on the squared error of all pixels, under a soft compare that hardens from phase to
# phase. The result is judged with the hard compare that a game would use.

# %%
problem = fit.TechniqueProblem(technique, shadow_map, surface, jnp.asarray(truth.visibility), jnp.asarray(mask))
parameters = [
    fit.Parameter("bias.constant", initial=0.2, lower=0.0, upper=16.0),
    fit.Parameter("filter.radius", initial=1.0, lower=0.0, upper=12.0),
]
result = fit.fit(problem, parameters, solver=fit.Solver(max_steps=15), anneal=fit.Anneal(2.0, 0.1, phases=3))
for name, value in result.fitted.items():
    print(f"{name}: {result.initial[name]:.2f} to {value:.2f} texels")
print(f"{result.steps} steps in {len(result.phases)} phases")

# %% [markdown]
# **Errors.** False shadow is acne. False light is light leaks and Peter-panning.

# %%
after = result.technique.visibility(shadow_map, surface)
for name, image in {"before": before, "after": after}.items():
    errors = metrics.measure_errors(image, truth.visibility, mask)
    print(
        f"{name:7} RMSE {errors.rmse:.4f}   SSIM {errors.ssim:.3f}   "
        f"false shadow {errors.false_shadow_rate:.2%}   false light {errors.false_light_rate:.2%} of light"
    )

# %% tags=["picture"]
figure, axes = plt.subplots(1, 3, figsize=(11, 3.6))
axes[0].imshow(after, vmin=0, vmax=1)
axes[0].set_title("after: visibility")
for ax, (name, image) in zip(axes[1:], {"before": before, "after": after}.items()):
    difference = np.where(mask, image - truth.visibility, np.nan)
    shown = ax.imshow(difference, cmap="PuOr", vmin=-1, vmax=1)
    ax.set_title(f"{name} less truth")
    ax.set_facecolor("#d5dce4")
for ax in axes:
    ax.set(xlabel="x [pixels]", ylabel="y [pixels]")
bar = figure.colorbar(shown, ax=axes[1:], shrink=0.8)
bar.set_label("too dark            too light")
