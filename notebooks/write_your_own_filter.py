# %% [markdown]
# # Write your own filter
#
# This notebook writes a filter in one cell, checks it and its gradient against a closed form, and fits it to a
# ray-traced shadow, in comparison with the usual uniform disk. A filter is a frozen module whose fields are its
# settings. It turns a map and its look-ups into visibility. The example weights the compares around a receiver by a
# Gaussian.

# %% tags=["hide-input"]
import os

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import norm

from diffshadow import fit, geometry, metrics, raster, reference, setup, shadow

setup()  # before the first array
plt.style.use("diffshadow.mplstyle")
SMALL = bool(os.environ.get("DIFFSHADOW_SMALL"))  # a quick run, for tests
pixels, texels, rays = (48, 96, 16) if SMALL else (192, 512, 128)

# %% [markdown]
# **The filter.** The density of taps follows a Gaussian and all taps have the same weight, so their mean is weighted by
# the Gaussian. Taps lie along a spiral (Vogel 1979). The circle through tap $i$ of $n$ contains the fraction
# $(i + ½) / n$ of the Gaussian, so its radius is $\sigma \sqrt{-2 \ln(1 - (i + ½) / n)}$. `mean_of_taps` does the
# look-ups and gives the derivatives.

# %%
class Gaussian(shadow.AbstractFilter):
    """The mean of compares weighed by a Gaussian of standard deviation `sigma`, in texels, by `taps` taps."""

    sigma: jax.Array = eqx.field(converter=jnp.asarray, default=1.0)
    taps: int = eqx.field(static=True, default=32)

    def __call__(self, shadow_map, lookup, compare):
        i = np.arange(self.taps)
        radius = np.sqrt(-2 * np.log(1 - (i + 0.5) / self.taps))
        angle = i * np.pi * (3 - np.sqrt(5))
        points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1) / radius[-1]
        pattern = shadow.Pattern(jnp.asarray(points, jnp.float32)[:, None, None])  # one set for all pixels
        return shadow.mean_of_taps(shadow_map, lookup, compare, self.sigma * radius[-1], pattern, "bilinear")


# %% [markdown]
# **Closed form.** Let all of a map left of $x = 16$ be a caster. A bilinear tap at a distance $x$ from the caster's
# edge then sees a ramp one texel wide, and the mean of such ramps under a Gaussian is
# $$v(x) = \sigma\,[\,G(\tfrac{x + ½}{\sigma}) - G(\tfrac{x - ½}{\sigma})\,], \quad G(z) = z\,\Phi(z) + \varphi(z),
# \qquad \frac{\partial v}{\partial \sigma} = \varphi(\tfrac{x + ½}{\sigma}) - \varphi(\tfrac{x - ½}{\sigma}).$$

# %%
depth = np.tile(np.where(np.arange(32) < 16, 0.2, 1.0), (32, 1)).astype(np.float32)
half_plane = shadow.ShadowMap(jnp.asarray(depth), geometry.DirectionalLight((0, -1, 0), (0, 0, 0), (1, 1), -1, 1))
x = np.linspace(-6, 6, 121, dtype=np.float32)
row = lambda value: jnp.full((1, x.size), value, jnp.float32)
texel = jnp.stack([jnp.asarray(16 + x)[None], row(16.3)], axis=-1)
lookup = shadow.Lookup(texel, row(0.5), row(0.05), inside=row(1) > 0)


@eqx.filter_jit
def seen(sigma, taps):
    return Gaussian(sigma, taps)(half_plane, lookup, shadow.HardCompare())[0]


def exact(sigma):
    G = lambda z: z * norm.cdf(z) + norm.pdf(z)
    value = sigma * (G((x + 0.5) / sigma) - G((x - 0.5) / sigma))
    return value, norm.pdf((x + 0.5) / sigma) - norm.pdf((x - 0.5) / sigma)


# %%
sigma, counts = 1.7, (8, 16, 32, 64, 128, 256)
figure, axes = plt.subplots(1, 3, figsize=(9.6, 3.0))
errors = []
for taps in counts:
    value, slope = jax.jvp(lambda s: seen(s, taps), (jnp.float32(sigma),), (jnp.float32(1),))
    errors.append([np.abs(np.asarray(a) - b).max() for a, b in zip((value, slope), exact(sigma))])
    if taps in (16, 256):
        axes[0].plot(x, value, label=f"{taps} taps")
        axes[1].plot(x, slope, label=f"{taps} taps")
for ax, curve, name in zip(axes, exact(sigma), ("visibility", "its derivative by sigma [1/texel]")):
    ax.plot(x, curve, "k:", label="closed form")
    ax.set(title=name, xlabel="distance from the edge [texels]")
    ax.legend()
axes[2].loglog(counts, errors, "o-", label=["visibility", "derivative [1/texel]"])
axes[2].set(title="greatest error", xlabel="taps per pixel")
axes[2].legend()
for ax in axes:
    ax.grid(True)
print(f"greatest error with {counts[-1]} taps: {errors[-1][0]:.4f}, of the derivative {errors[-1][1]:.4f} per texel")
assert errors[-1][0] < 0.01 and errors[-1][1] < 0.02

# %% [markdown]
# **A scene** under a sun of 2° radius, and its ray-traced truth.

# %%
knot = geometry.fit_to_size(geometry.library_mesh("torus_knot"), 1.0)
meshes = [geometry.drop_to_ground(knot), geometry.library_mesh("plane", size=3.0)]
camera = geometry.PinholeCamera((1.3, 1.6, 2.0), (0.3, 0.2, 0.0), fov_y=38.0, resolution=(pixels, pixels))
light = geometry.DirectionalLight.around((0.5, -1.0, -0.3), geometry.merge(meshes).vertices, angular_radius=2.0)
scene = geometry.Scene(meshes, camera, light)
truth = reference.trace_visibility(scene, samples=rays)

# %% [markdown]
# **Fit.** Any number in the filter can be fitted by its name, here `filter.sigma`, together with the bias. The uniform
# disk has the same number of taps.

# %%
bias = shadow.Bias(constant=0.5, slope=0.5, normal_offset=0.0)  # texels
filters = {
    "Gaussian": (Gaussian(1.0), fit.Parameter("filter.sigma", 1.0, 0.1, 6.0)),
    "uniform disk": (shadow.RandomDisk(2.0, shadow.vogel(32, rotated=False)), fit.Parameter("filter.radius", 2.0, 0.1, 12.0)),
}
pictures = {"ray traced": truth.visibility}
for name, (kernel, width) in filters.items():
    technique = shadow.ShadowMapping(kernel, bias, map=shadow.MapSettings((texels, texels)))
    problem = fit.TechniqueProblem.of(scene, technique, truth)
    shadow_map, surface, mask = problem.shadow_map, problem.surface, problem.mask
    result = fit.fit(
        problem,
        [fit.Parameter("bias.constant", 0.5, 0.0, 16.0), width],
        solver=fit.Solver(max_steps=12),
        anneal=fit.Anneal(2.0, 0.1, phases=2 if SMALL else 3),
    )
    pictures[name] = result.technique.visibility(shadow_map, surface)
    error = lambda values: metrics.rmse(
        fit.with_values(result.technique, list(values), jnp.array(list(values.values()))).visibility(shadow_map, surface),
        truth.visibility,
        mask,
    )
    told = ", ".join(f"{key} {value:.2f} texels" for key, value in result.fitted.items())
    print(f"{name:12} RMSE {error(result.initial):.4f} before, {error(result.fitted):.4f} after: {told}")
print(f"noise of the reference: RMSE {truth.noise_floor:.4f}")

# %% tags=["picture"]
figure, axes = plt.subplots(1, 3, figsize=(11, 3.6))
for ax, (name, image) in zip(axes, pictures.items()):
    shown = ax.imshow(image, vmin=0, vmax=1)
    ax.set(title=name, xlabel="x [pixels]", ylabel="y [pixels]")
bar = figure.colorbar(shown, ax=axes, shrink=0.8, label="visibility")

# %% [markdown]
# **From YAML.** Save the class in a file `my_filters.py` beside a configuration, or in a package. The key
# `filter: {type: my_filters:Gaussian, sigma: 2}` then selects the filter. The fields of the class are the keys, and
# `filter.sigma` can be fitted. See "Filters, techniques and losses of your own" in `docs/usage.md`.
