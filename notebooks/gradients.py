# %% [markdown]
# # Gradients: what moves a shadow
#
# This notebook draws the gradient of visibility with respect to bias, filter radius and soft compare, the position and
# direction of lights, a mesh's pose, and all of its vertices. Each gradient is drawn over the shadow: orange
# pixels get lighter as the number grows, and purple pixels get darker. `docs/gradients.md` says which gradients are
# exact, and what has no gradient.

# %% tags=["hide-input"]
import dataclasses
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import diffshadow
from diffshadow import fit, geometry, raster, shadow

diffshadow.collect_rarely()  # Python's garbage collector would slow down compiling
plt.style.use("diffshadow.mplstyle")
SMALL = bool(os.environ.get("DIFFSHADOW_SMALL"))  # a quick run, for tests
pixels, texels = (48, 96) if SMALL else (192, 256)

# %% [markdown]
# **Scene.** A torus knot on a floor, under the sun. `on_floor` marks the pixels that see the floor.

# %%
knot = geometry.library_mesh("torus_knot", segments=64, sides=8)
knot = geometry.drop_to_ground(geometry.fit_to_size(knot, 1.0))
floor = geometry.library_mesh("plane", size=3.0)
camera = geometry.PinholeCamera((1.3, 1.4, 1.8), (0.1, 0.35, 0.0), fov_y=38.0, resolution=(pixels, pixels))
sun = geometry.DirectionalLight.around((0.5, -1.0, -0.3), geometry.merge([knot, floor]).vertices)
scene = geometry.Scene([knot, floor], camera, sun)
surface = raster.draw_surface(scene.mesh, camera)
on_floor = surface.face >= len(knot.faces)


def draw_over(image, gradients):
    """Each gradient in colours over the shadow in grey."""
    figure, axes = plt.subplots(1, len(gradients), figsize=(3.9 * len(gradients), 3.2), squeeze=False)
    for ax, (title, gradient) in zip(axes[0], gradients.items()):
        gradient = np.where(surface.mask, gradient, 0)
        limit = max(float(np.quantile(np.abs(gradient), 0.99)), 1e-6)
        ax.imshow(image, vmin=-1.5, vmax=1)
        shown = ax.imshow(
            gradient, cmap="PuOr_r", vmin=-limit, vmax=limit, alpha=np.clip(3 * np.abs(gradient) / limit, 0, 1)
        )
        figure.colorbar(shown, ax=ax, shrink=0.8)
        ax.set(title=title, xlabel="x [pixels]", ylabel="y [pixels]")


# %% [markdown]
# **Bias, radius and width.** The map does not depend on these, so it is drawn once. The compare must be soft, since a
# hard compare has no gradient with respect to the bias.

# %%
shadow_map = shadow.draw_shadow_map(scene.mesh, sun, (texels, texels))


def soft(bias, radius, width):
    parts = shadow.RandomDisk(radius), shadow.Bias(constant=bias), shadow.SoftCompare(width)
    return (shadow.ShadowMapping(*parts).visibility(shadow_map, surface),) * 2


gradients, image = jax.jit(jax.jacfwd(soft, argnums=(0, 1, 2), has_aux=True))(1.0, 2.0, 0.5)

# %% tags=["picture"]
names = "by bias [1/texel]", "by radius [1/texel]", "by width [1/texel]"
draw_over(image, dict(zip(names, gradients)))

# %% [markdown]
# **Many biases at once.** `vmap` maps value and gradient over an array. Dashed lines are tangents.

# %%
biases = jnp.linspace(0.0, 4.0, 9)
mean = lambda bias: jnp.mean(soft(bias, 2.0, 0.5)[0])
values, slopes = jax.jit(jax.vmap(jax.value_and_grad(mean)))(biases)

# %%
figure, ax = plt.subplots(figsize=(4.6, 3.0))
ax.plot(biases, values, "o-")
for x, y, slope in zip(biases, values, slopes):
    ax.plot([x - 0.3, x + 0.3], [y - 0.3 * slope, y + 0.3 * slope], "--", color="#d55e00")
ax.set(title="light that is left", xlabel="bias [texels]", ylabel="mean visibility")
ax.grid(True)

# %% [markdown]
# **A light and a mesh.** Both move the shadow's outline, so the map needs silhouettes. A plan, which is made outside of
# `jit`, contains the edges and the memory for silhouettes. With silhouettes, any compare works, also a hard one.

# %%
settings = shadow.MapSettings((texels, texels), silhouettes=True)
hard = shadow.ShadowMapping(shadow.PercentageCloser(2.0), shadow.Bias(constant=4.0), map=settings)


def cast(mesh, light, plan):
    moved = geometry.Scene([mesh, floor], camera, light)
    return hard.visibility(hard.prepare(moved, plan=plan), surface)


# %%
lamp = geometry.SpotLight.around((-1.2, 3.0, 0.9), scene.mesh.vertices)
lamp_plan = hard.plan(dataclasses.replace(scene, lights=lamp))
pose = fit.MeshPose.of(knot)


def under_lamp(position, direction, moves):
    mesh = fit.with_values(pose, ("translate.x", "turn.y"), moves).placed(knot)
    light = dataclasses.replace(lamp, position=position, direction=direction)
    return (cast(mesh, light, lamp_plan),) * 2


by_lamp = jax.jit(jax.jacfwd(under_lamp, argnums=(0, 1, 2), has_aux=True))
(by_position, by_direction, by_pose), image = by_lamp(lamp.position, lamp.direction, jnp.zeros(2))

# %%
draw_over(
    image,
    {
        "by the lamp's x [1/world unit]": by_position[..., 0] * on_floor,
        "by its direction's x": by_direction[..., 0] * on_floor,
        "by the knot's x [1/world unit]": by_pose[..., 0] * on_floor,
        "by its turn about y [1/degree]": by_pose[..., 1] * on_floor,
    },
)

# %% [markdown]
# A lamp that turns without moving does not move the shadow. So the gradient with respect to its direction is small, and
# shows the motion of the map's texels.
#
# **All vertices, under several suns.** Reverse mode finds the gradient of one number with respect to any number of
# inputs. `vmap` maps it over suns. The number is the light on the floor.

# %%
plan = hard.plan(scene)


def light_on_floor(vertices, direction):
    light = dataclasses.replace(sun, direction=direction)
    image = cast(dataclasses.replace(knot, vertices=vertices), light, plan)
    return jnp.mean(image, where=on_floor)


suns = sun.direction + jnp.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.3], [-0.6, 0.0, 0.5]])
under_suns = jax.jit(jax.vmap(jax.grad(light_on_floor, argnums=(0, 1)), in_axes=(None, 0)))
by_vertices, by_suns = under_suns(knot.vertices, suns)
print(f"gradients by vertices {by_vertices.shape}, by directions {by_suns.shape}")

# %% [markdown]
# The vertices on the outline that a sun sees darken the floor when they move outwards. Each face shows the sum over its
# vertices.

# %%
normals = np.zeros(knot.vertices.shape)
np.add.at(normals, np.asarray(knot.faces), np.asarray(knot.corner_normals))
normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
faces = np.sum(np.sum(np.asarray(by_vertices) * normals, axis=-1)[:, np.asarray(knot.faces)], axis=-1)
seen = np.asarray(surface.face)
by_face = [np.where((seen >= 0) & (seen < len(knot.faces)), of_sun[np.minimum(seen, len(of_sun) - 1)], 0) for of_sun in faces]
shading = np.where(seen < len(knot.faces), 0.4, 1.0)
draw_over(shading, {f"outwards, under sun {k + 1} [1/world unit]": image for k, image in enumerate(by_face)})

# %% [markdown]
# **Check.** We move the lamp along x, and compare the change on the floor with the gradient's prediction.

# %%
step = jnp.array([0.05, 0.0, 0.0])
lit = lambda position: float(jnp.mean(by_lamp(position, lamp.direction, jnp.zeros(2))[1], where=on_floor))
difference = (lit(lamp.position + step) - lit(lamp.position - step)) / 0.1
slope = float(jnp.mean(by_position[..., 0], where=on_floor))
print(f"by the lamp's x: gradient {slope:.3f}, central difference {difference:.3f} per world unit")
assert SMALL or abs(slope - difference) < 0.15 * abs(difference)
