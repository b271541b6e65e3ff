"""Biases and kernels in GLSL: visibility by OpenGL with the exported functions, beside ours."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import lamp, marked, sun

from diffshadow.geometry import PinholeCamera, Scene, library_mesh, merge
from diffshadow.raster import draw_surface
from diffshadow.shadow import (
    AdaptiveBias,
    Bias,
    Castano,
    ConstantBias,
    LinearBias,
    MapSettings,
    NormalOffset,
    PerceptronBias,
    ReceiverPlane,
    Separable,
    ShadowMapping,
    SlopeBias,
    Tent,
    to_glsl,
)

SIDE = 128
VERTEX = """
#version 330
in vec2 corner;
void main() { gl_Position = vec4(corner, 0.0, 1.0); }
"""
# What a shader has to do around the exported functions: project the receiver and find what they ask for.
MAIN = """
uniform sampler2D positions, normals, depths;
uniform mat4 world_to_eye, eye_to_clip;
uniform vec4 light;  // the way to it with w = 0, the point it shines from with w = 1
uniform float near, far;
out float lit;

vec3 window(vec3 world) {
    vec4 clip = eye_to_clip * (world_to_eye * vec4(world, 1.0));
    return clip.xyz / clip.w * 0.5 + 0.5;
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy), size = textureSize(depths, 0);
    vec3 world = texelFetch(positions, pixel, 0).xyz, normal = texelFetch(normals, pixel, 0).xyz;
    vec3 eye = (world_to_eye * vec4(world, 1.0)).xyz, facing = mat3(world_to_eye) * normal;
    bool perspective = eye_to_clip[3][3] == 0.0;
    float along = -eye.z, span = far - near, width = perspective ? along : 1.0;
    // World units a texel is wide and high, and window depth over its width.
    vec2 extent = 2.0 * width / (vec2(eye_to_clip[0][0], eye_to_clip[1][1]) * vec2(size));
    float texel = sqrt(extent.x * extent.y);
    float unit = texel / span * (perspective ? far * near / (along * along) : 1.0);
    float towards = dot(facing, perspective ? eye / along : vec3(0.0, 0.0, -1.0));
    float least = length(facing.xy) / 100.0;
    towards = abs(towards) > least ? towards : towards < 0.0 ? -least : least;
    vec2 slope = -facing.xy / towards * extent / texel;
    float cosine = dot(normal, normalize(light.xyz - light.w * world));
    vec3 at = window(world);
    bool inside = all(greaterThanEqual(at.xy, vec2(0.0))) && all(lessThan(at.xy, vec2(1.0)));
    float stored = inside ? texelFetch(depths, ivec2(at.xy * vec2(size)), 0).r : 1.0;
    float bias = shadow_bias(slope, cosine, 100.0 * texel / span, (along - near) / span, (at.z - stored) / unit);
    at = window(world + normal * texel * shadow_normal_offset(cosine));
    lit = at.z <= 1.0 ? shadow_visibility(depths, at.xy * vec2(size), at.z - bias * unit) : 1.0;
    lit = cosine > 0.0 ? lit : 0.0;
}
"""


@pytest.fixture(scope="module")
def gl():
    pytest.importorskip("moderngl")
    from _opengl import OpenGL

    try:
        return OpenGL()
    except Exception as error:
        pytest.skip(f"there is no OpenGL here: {error}")


def drawn_by_opengl(gl, shader, shadow_map, surface, light):
    """Visibility (h, w) by a fragment shader."""
    import moderngl

    context, view = gl.context, shadow_map.view
    program = context.program(vertex_shader=VERTEX, fragment_shader=shader)
    images = {"positions": surface.position, "normals": surface.normal, "depths": shadow_map.depth[..., None]}
    for unit, (name, image) in enumerate(images.items()):
        height, width, channels = image.shape
        texture = context.texture((width, height), channels, np.ascontiguousarray(image).tobytes(), dtype="f4")
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture.use(unit)
        program[name] = unit
    program["world_to_eye"].write(np.asarray(view.world_to_eye).T.tobytes())
    program["eye_to_clip"].write(np.asarray(view.eye_to_clip).T.tobytes())
    for name, value in {"light": light, "near": float(view.near), "far": float(view.far)}.items():
        program[name] = value
    corners = context.buffer(np.array([-1, -1, 3, -1, -1, 3], np.float32).tobytes())
    height, width = surface.mask.shape
    target = context.framebuffer([context.texture((width, height), 1, dtype="f4")])
    target.use()
    context.enable_only(context.NOTHING)
    context.vertex_array(program, [(corners, "2f", "corner")]).render(context.TRIANGLES)
    return np.frombuffer(target.read(components=1, dtype="f4"), np.float32).reshape(height, width)


def trained():
    """A perceptron of all features, as a training leaves it: no weight is 0."""
    weights = (1.0, 0.4, 0.2, 0.3, 0.5, -0.6, 0.02)
    names = ("one", "slope", "sine", "one_minus_cosine", "texel_size", "distance", "blocker_distance")
    bias = PerceptronBias.correcting(LinearBias(dict(zip(names, weights, strict=True))), seed=1)
    return eqx.tree_at(lambda bias: bias.last, bias, jnp.linspace(-1, 1.5, bias.last.size))


TECHNIQUES = {
    "linear": (
        Bias(
            ConstantBias(0.1),
            SlopeBias(0.2, least=0.05, most=0.5),
            0.4,
            terms=LinearBias({"one": 0.1, "slope": 0.3, "one_minus_cosine": 0.4, "blocker_distance": 0.1}),
        ),
        Separable((0.9, 0.5, 0.2)),
    ),
    "perceptron": (Bias(0, 0, NormalOffset(0.3, "one_minus_cosine"), terms=trained()), Castano(3)),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("light", ["spot", pytest.param("directional", marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("name", marked(TECHNIQUES, {"linear"}))
def test_visibility_with_exported_functions_is_ours(gl, name, light):
    bias, kernel = TECHNIQUES[name]
    meshes = [library_mesh("torus", segments=14, sides=8), library_mesh("plane", size=3.0)]
    of_light = {"directional": sun, "spot": lamp}[light](merge(meshes))
    camera = PinholeCamera((1.6, 1.4, 2.0), (0.0, 0.2, 0.0), fov_y=40, near=0.1, far=10, resolution=(SIDE, SIDE))
    scene = Scene(meshes, camera, of_light)
    technique = ShadowMapping(kernel, bias, map=MapSettings((SIDE, SIDE)))
    surface, state = draw_surface(scene.mesh, camera), technique.prepare(scene)
    ours, mask = np.asarray(technique.visibility(state, surface)), np.asarray(surface.mask)
    at = (*(-np.asarray(of_light.direction)), 0.0) if light == "directional" else (*np.asarray(of_light.position), 1.0)
    shader = "\n".join(["#version 330", to_glsl(bias), to_glsl(kernel), MAIN])
    theirs = drawn_by_opengl(gl, shader, state, surface, tuple(map(float, at)))
    differ = np.abs(theirs - ours)[mask] > 1e-4
    assert differ.mean() <= 1e-3
    penumbra = (ours > 0.01) & (ours < 0.99) & mask
    assert penumbra.sum() > 200
    # The bias matters: without it, far more pixels differ.
    without = np.asarray(eqx.tree_at(lambda t: t.bias, technique, Bias()).visibility(state, surface))
    assert (np.abs(without - ours)[mask] > 1e-4).mean() > 0.03


def test_exported_bias_is_a_few_lines_with_all_digits():
    text = to_glsl(Bias(0.1, terms=LinearBias({"one": 1 / 3, "distance": -2.0})))
    assert "return 0.100000001 + max(0.333333343 + -2.0 * (clamp(light_distance, 0.0, 1.0)), 0.0);" in text
    assert "shadow_normal_offset" not in text
    assert "return 0.0;" in to_glsl(Bias())
    assert "max(0.0 * (length(slope)), 0.5)" in to_glsl(SlopeBias(0.0, least=0.5))
    assert "const float k[5] = float[](0.0, 0.25, 0.5, 0.25, 0.0);" in to_glsl(Castano(3))
    assert len(to_glsl(trained()).splitlines()) < 25


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (Bias(plane=ReceiverPlane()), r"has a plane, which has no GLSL; expected a bias without: leave it out"),
        (Bias(1.0, factors=(1.0, 2.0)), r"has factors, which has no GLSL"),
        (ConstantBias(0.1, "depth"), r"the bias is in window depth, which has no GLSL; expected .* in texels"),
        (Bias(terms=SlopeBias(0.1, unit="depth")), r"the bias is in window depth"),
        (AdaptiveBias(), r"the bias is of type AdaptiveBias, which has no GLSL"),
        (Tent(2.0), r"the filter is of type Tent, which has no GLSL; expected Separable or Castano"),
    ],
)
def test_what_has_no_glsl_is_reported(part, message):
    with pytest.raises(ValueError, match=message):
        to_glsl(part)
