# %% [markdown]
# # Shadow art: one sculpture, two pictures
#
# This notebook makes a sculpture whose shadows on two walls are a heart and a star. It starts from a ball in front of
# the walls, with a light for each wall, and moves every vertex of the ball. The gradient comes from the outlines of the
# shadows alone.

# %% tags=["hide-input"]
import os

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.path import Path

from diffshadow import fit, geometry, metrics, raster, reference, setup

setup()  # before the first array
plt.style.use("diffshadow.mplstyle")
SMALL = bool(os.environ.get("DIFFSHADOW_SMALL"))  # a quick run, for tests
PIXELS, SPLITS, STEPS = (48, 3, 60) if SMALL else (128, 4, 150)
SIDE = 1.6  # of the square that a picture shows, world units

# %% [markdown]
# **The pictures** are 1 where the wall should be lit and 0 where it should be dark. They have the same height: under
# level lights, both shadows are as tall as the sculpture.

# %%
def picture(outline, height=1.0, fine=4):
    """The picture of a polygon: (PIXELS, PIXELS), row 0 at the bottom, each pixel the mean of `fine` x `fine` points."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    at = (np.arange(PIXELS * fine) + 0.5) / (PIXELS * fine) * SIDE - SIDE / 2
    points = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    inside = Path((outline - (low + high) / 2) * height / (high - low)[1]).contains_points(points)
    return 1 - inside.reshape(PIXELS, fine, PIXELS, fine).mean(axis=(1, 3))


t = np.linspace(0, 2 * np.pi, 200)
heart = np.stack([16 * np.sin(t) ** 3, 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t)], axis=1)
turn, radius = np.pi / 2 + np.pi / 5 * np.arange(10), np.where(np.arange(10) % 2, 0.45, 1.0)
star = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
pictures = {"heart": picture(heart), "star": picture(star)}

# %% [markdown]
# **Lights and walls.** Each view has a light, the surface of the wall behind the sculpture, and the picture. A pixel is
# as large as a texel of the light's shadow map. With the map's silhouettes, the value of a pixel is the exact fraction
# of the pixel that is lit.

# %%
UP, AWAY = np.array([0.0, 1.0, 0.0]), 1.3
WAYS = [np.array([0.0, 0.0, -1.0]), np.array([-1.0, 0.0, 0.0])]


def wall(way, half):
    """A square that light along `way` falls on."""
    across, centre = np.cross(way, UP) * half, way * AWAY
    return geometry.Mesh([centre + a * across + b * UP * half for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))], [[0, 1, 2], [0, 2, 3]])


lights = [geometry.DirectionalLight(way, np.zeros(3), (SIDE, SIDE), -2, 2, angular_radius=0) for way in WAYS]
cameras = [
    geometry.OrthographicCamera(way * (AWAY - 0.2), way * AWAY, UP, SIDE, near=0.1, far=1, resolution=(PIXELS, PIXELS))
    for way in WAYS
]
surfaces = [raster.draw_surface(wall(way, SIDE), camera) for way, camera in zip(WAYS, cameras)]
views = [fit.ShapeView(*each) for each in zip(lights, surfaces, pictures.values())]

# %% [markdown]
# **Fit.** Plain gradient steps would shred the mesh: only the few vertices on an outline have a gradient. "Large steps"
# (Nicolet, Jacobson & Jakob 2021) move neighbours together. Their strength falls from phase to phase: first the rough
# shape forms, then the details.

# %%
sphere = geometry.library_mesh("sphere", radius=0.5, subdivisions=SPLITS)
start = geometry.Mesh(np.asarray(sphere.vertices) - [0, 0.5, 0], sphere.faces)
phases = [fit.ShapePhase(20, 0.1, STEPS), fit.ShapePhase(5, 0.05, STEPS), fit.ShapePhase(2, 0.02, 2 * STEPS // 3)]
steps = []
result = fit.fit_shape(fit.ShapeProblem(start, views), phases, on_step=lambda step: steps.append((step.vertices, step.images)))
print(f"{len(start.vertices):,} vertices, {len(steps)} steps")
print(f"mean square error {result.initial_loss:.1e} before, {result.loss:.1e} after")
print("after each phase: " + ", ".join(f"{loss:.1e}" for loss in result.losses))

# %% [markdown]
# **The shadows**, from the sphere to the pictures.

# %%
ends = np.cumsum([0, *(phase.steps for phase in phases)])
shown = [0, ends[1] // 6, ends[1] - 1, ends[3] - 1]
figure, axes = plt.subplots(2, 5, figsize=(10.4, 4.2))
for row, (kind, target) in enumerate(pictures.items()):
    images = {kind: target, **{f"step {step}": steps[step][1][row] for step in shown}}
    for ax, (name, image) in zip(axes[row], images.items()):
        ax.imshow(image, vmin=0, vmax=1)
        ax.set(xticks=[], yticks=[], title=name)

# %% [markdown]
# **The sculpture** before its walls, ray traced. Each wall is lit by its own light, which only grazes the other wall.

# %% tags=["picture"]
def room(mesh, side=110 if SMALL else 420, fine=2):
    """A picture of the sculpture and its shadows on both walls."""
    camera = geometry.PinholeCamera((3.3, 1.0, 3.3), (-0.6, 0, -0.6), fov_y=34, resolution=(side * fine, side * fine))
    scene = geometry.Scene([mesh, *(wall(way, AWAY) for way in WAYS)], camera, lights)
    surface = raster.draw_surface(scene.mesh, camera)
    colour = np.where(np.asarray(surface.face)[..., None] < len(mesh.faces), [0.86, 0.62, 0.38], [0.93, 0.92, 0.9])
    light = np.full((*surface.mask.shape, 1), 0.22)
    for i, way in enumerate(WAYS):
        seen = np.asarray(reference.trace_visibility(scene.lit_by(i), 1).visibility)
        light += 0.7 * (seen * np.clip(-np.asarray(surface.normal) @ way, 0, 1))[..., None]
    image = np.where(np.asarray(surface.mask)[..., None], colour * light, 1.0)
    return np.clip(image.reshape(side, fine, side, fine, 3).mean(axis=(1, 3)), 0, 1)


figure, axes = plt.subplots(1, 3, figsize=(10.4, 3.6))
faces = np.asarray(start.faces)
meshes = {"start": start, f"step {shown[1]}": geometry.Mesh(steps[shown[1]][0], faces), "result": result.mesh}
for ax, (name, mesh) in zip(axes, meshes.items()):
    ax.imshow(room(mesh))
    ax.set(xticks=[], yticks=[], title=name)

# %% [markdown]
# **How close?** The overlap is the intersection of shadow and picture over their union. The shadows here are ray
# traced, by code that shares nothing with the fitted shadow maps.

# %%
overlaps = []
for (kind, target), way, light, camera in zip(pictures.items(), WAYS, lights, cameras):
    scene = geometry.Scene([result.mesh, wall(way, SIDE)], camera, light, (True, False))
    traced = reference.trace_visibility(scene, 1, supersampling=4).visibility
    overlaps.append(metrics.intersection_over_union(traced, target))
    print(f"{kind}: {overlaps[-1]:.4f}")

# %%
figure, ax = plt.subplots(figsize=(6.4, 2.8))
history = np.array(result.history)
ax.semilogy(np.sqrt(history[:, 1]))
for end in ends[1:-1]:
    ax.axvline(end, color="#8b949e", linewidth=0.8, linestyle=":")
ax.set(xlabel="step", ylabel="RMSE, blurred [visibility]", title="each phase smooths less than the one before")
ax.grid(True)

# %%
assert min(overlaps) > (0.9 if SMALL else 0.97)
assert result.loss < 0.2 * result.initial_loss
