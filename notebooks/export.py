# %% [markdown]
# # Into your own renderer: fit, export, check
#
# This notebook brings a fitted shadow into your own renderer. It fits bias and filter radius, exports the technique as
# GLSL, and runs the exported text by OpenGL on the same shadow map. Both pictures are the same.
#
# `diffshadow export RUN` does this for a run's folder, and `--page` adds a page for the browser.

# %% tags=["hide-input"]
import os

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

from diffshadow import fit, geometry, raster, reference, setup, shadow

setup()  # before the first array
plt.style.use("diffshadow.mplstyle")
SMALL = bool(os.environ.get("DIFFSHADOW_SMALL"))  # a quick run, for tests
pixels, texels, rays = (48, 96, 16) if SMALL else (192, 384, 64)

# %% [markdown]
# **Fit**: a chair under a wide sun. The filter is a disk of 16 points, turned from pixel to pixel.

# %%
chair = geometry.drop_to_ground(geometry.fit_to_size(geometry.library_mesh("chair"), 1.0))
meshes = [chair, geometry.library_mesh("plane", size=3.0)]
camera = geometry.PinholeCamera((1.2, 1.4, 1.8), (0.15, 0.35, 0.0), fov_y=36.0, resolution=(pixels, pixels))
light = geometry.DirectionalLight.around((0.7, -1.0, -0.3), geometry.merge(meshes).vertices, angular_radius=1.5)
scene = geometry.Scene(meshes, camera, light)
technique = shadow.ShadowMapping(
    filter=shadow.RandomDisk(radius=1.0, pattern=shadow.vogel(16, rotated=True)),
    bias=shadow.Bias(constant=0.2, slope=0.3, normal_offset=0.0),  # texels
    map=shadow.MapSettings(resolution=(texels, texels)),
)
shadow_map, surface = technique.prepare(scene), raster.draw_surface(scene.mesh, camera)
truth = reference.trace_visibility(scene, samples=rays)
mask = np.asarray(technique.covered(shadow_map, surface)) & truth.mask
problem = fit.TechniqueProblem(technique, shadow_map, surface, jnp.asarray(truth.visibility), jnp.asarray(mask))
parameters = [
    fit.Parameter("bias.constant", initial=0.2, lower=0.0, upper=16.0),
    fit.Parameter("filter.radius", initial=1.0, lower=0.0, upper=12.0),
]
result = fit.fit(problem, parameters, solver=fit.Solver(max_steps=15), anneal=fit.Anneal(2.0, 0.1, phases=2))
for name, value in result.fitted.items():
    print(f"{name}: {result.initial[name]:.2f} to {value:.2f} texels")

# %% [markdown]
# **Export.** The fitted values are at the top, as constants with their units. Below them are functions; call `shadow`.

# %%
shader = shadow.to_shader(result.technique, light)
lines = shader.splitlines()
print("\n".join(line for line in lines if line.startswith("const") and ("_BIAS =" in line or "_RADIUS =" in line)))
print(next(line for line in lines if line.startswith("float shadow(")))

# %% [markdown]
# **Check.** OpenGL draws one triangle over the whole picture. Its fragment shader contains the exported text, and reads
# the receivers' positions and normals from textures. A renderer has these at hand anyway.


# %%
def drawn(shader):
    """Visibility by the exported shader, (h, w); none without OpenGL."""
    try:
        import moderngl

        context = moderngl.create_standalone_context(require=330, backend="egl")
    except Exception as error:
        print(f"OpenGL does not run here, so the shader is not checked: {error}")
        return None
    program = context.program(
        vertex_shader="""
        #version 330
        in vec2 corner;
        void main() { gl_Position = vec4(corner, 0.0, 1.0); }""",
        fragment_shader=f"""
        #version 330
        {shader}
        uniform sampler2D depths, positions, normals;
        uniform mat4 world_to_eye, eye_to_clip;
        uniform vec3 towards;
        out float lit;
        void main() {{
            ivec2 at = ivec2(gl_FragCoord.xy);
            vec3 position = texelFetch(positions, at, 0).xyz, normal = texelFetch(normals, at, 0).xyz;
            lit = shadow(depths, world_to_eye, eye_to_clip, position, normal, towards, floor(gl_FragCoord.xy), 0);
        }}""".strip(),
    )
    view = light.view()
    for name in ("world_to_eye", "eye_to_clip"):
        program[name].write(np.asarray(getattr(view, name)).T.tobytes())  # column after column
    towards = np.asarray(light.towards(jnp.zeros(3)))
    program["towards"] = tuple(float(x) for x in towards / np.linalg.norm(towards))
    images = {"depths": shadow_map.depth[..., None], "positions": surface.position, "normals": surface.normal}
    for unit, (name, image) in enumerate(images.items()):
        height, width, channels = image.shape
        texture = context.texture((width, height), channels, np.asarray(image).tobytes(), dtype="f4")
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture.use(unit)
        program[name] = unit
    picture = context.framebuffer([context.texture((pixels, pixels), 1, dtype="f4")])
    picture.use()
    corners = context.buffer(np.array([-1, -1, 3, -1, -1, 3], np.float32).tobytes())
    context.vertex_array(program, [(corners, "2f", "corner")]).render(moderngl.TRIANGLES)
    return np.frombuffer(picture.read(components=1, dtype="f4"), np.float32).reshape(pixels, pixels)


ours = np.asarray(result.technique.visibility(shadow_map, surface))
theirs = drawn(shader)

# %% tags=["picture"]
figure, axes = plt.subplots(1, 3, figsize=(11, 3.6))
panels = {"ray traced": truth.visibility, "fitted, by diffshadow": ours, "fitted, by the exported GLSL": theirs}
for ax, (title, image) in zip(axes, panels.items()):
    if image is None:
        ax.text(0.5, 0.5, "not drawn", ha="center", transform=ax.transAxes)
    else:
        ax.imshow(np.where(mask, image, np.nan), cmap="gray", vmin=0, vmax=1)
    ax.set_title(title)
    ax.set(xlabel="x [pixels]", ylabel="y [pixels]", facecolor="#d5dce4")
if theirs is not None:
    equal = float((np.abs(theirs - ours)[mask] <= 1 / 255).mean())
    print(f"{equal:.2%} of the pixels are equal within 1/255")
    assert equal > 0.999
