"""Receivers, biases, compares, filters, layouts, silhouettes and maps."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from diffshadow import geometry, raster, shadow
from diffshadow.geometry import Edges, LightPose, Vector
from diffshadow.raster import DepthTest, Fragments
from diffshadow.shadow import Lookup, ShadowMap, SoftCompare
from diffshadow.shadow._draw_map import _stored
from diffshadow.shadow._map_depths import midpoint, unwarped_depth
from diffshadow.shadow._receiver import project
from diffshadow.shadow._shadow_mapping import _visibility
from diffshadow.shadow.kernels import Blur
from diffshadow.shadow.layouts import CascadedLight
from diffshadow.shadow.layouts._cascades import Cascades
from diffshadow.shadow.silhouettes import HalfPlanes, Outline, Rectangle, SilhouetteMap, cut_area, find_silhouettes
from diffshadow.shadow.silhouettes._contour import _left_of, _moved, _Points

from . import centres, faces_at, numbers, row, surface_of
from .of_geometry import lamp, pyramid, spot, sun

MAP = 9, 11
_NORMALS = np.array(
    [[(0.2, 0.9, 0.1), (0.5, 0.6, -0.2), (-0.3, 0.8, 0.4)], [(0.1, 0.7, 0.7), (0.6, 0.7, 0.1), (0, 1, 0)]]
)


def random_map(light, *layers):
    return ShadowMap(numbers(20, *layers, *MAP, low=0.3, high=0.7), light)


def points():
    place = numbers(21, 2, 3, 3, low=-0.4, high=0.4)
    return place, jnp.asarray(_NORMALS / np.linalg.norm(_NORMALS, axis=-1, keepdims=True))


def _received(light, at, numbers_of_pose):
    """Receivers under a light, by its pose, and by where they are and how they are turned."""

    @row(
        f"receivers under a {light.__name__}",
        (*numbers_of_pose, 0.1, -0.2, 0.05, 0.1, 0.05),
        "shadow.receiver shadow.Receiver",
        step=1e-4,
    )
    def _():
        place, normal = points()
        own, depth = light(), numbers(20, *([6] if light is lamp else []), *MAP)

        def of(x):
            x, moves, turn = x[:-5], x[-5:-2], x[-2:]
            turned = normal + jnp.concatenate([turn, jnp.zeros(1)])
            surface = surface_of(place + moves, turned / jnp.linalg.norm(turned, axis=-1, keepdims=True))
            seen = shadow.receiver(ShadowMap(depth, own.at(at(x))), surface)
            fields = ("cosine", "texel", "depth", "texel_size", "depth_per_texel", "slope", "distance")
            return {name: getattr(seen, name) for name in fields}

        return of


_received(spot, lambda x: LightPose(Vector(*x[:3]), *x[3:], spot().radius), (0.9, 2.1, 0.8, 31.0, 62.0))
_received(sun, lambda x: LightPose(None, *x, sun().angular_radius), (31.0, 62.0))
_received(lamp, lambda x: LightPose(Vector(*x), radius=lamp().radius), (0.2, 0.9, 0.1))


@row(
    "how large texels are on the screen",
    [0.1, -0.2, 0.05, 1.4, 1.8, 2.2],
    "shadow.aliasing shadow.Aliasing",
    tolerance=1e-5,
)
def _():
    from diffshadow.shadow._aliasing import aliasing

    place, normal = points()
    camera = geometry.PinholeCamera((1.4, 1.8, 2.2), (0.1, 0.2, 0), (0.1, 1, 0), 41, 0.7, 6, (12, 20))

    def of(x):
        found = aliasing(random_map(spot()), surface_of(place + x[:3], normal), dataclasses.replace(camera, eye=x[3:]))
        return found.jacobian, found.perspective, found.extent, found.least_extent, found.area

    return of


def at_a_receiver(**more):
    """Receivers as a spot light sees them, of two layers."""
    place, normal = points()
    seen = jax.jit(shadow.receiver)(random_map(spot()), surface_of(place, normal))
    layer = jnp.asarray([[0, 1, 0], [1, 1, 0]])
    return dataclasses.replace(seen, **({"layer": layer, "stored": seen.depth - 0.004 * numbers(22, 2, 3)} | more))


@row(
    "the sum of biases",
    [0.8, 0.6, 0.4, 0.5, 1.2, 0.4, 0.31, 1.1, 1.7],
    "Bias.constant Bias.slope Bias.normal_offset Bias.slope_least Bias.slope_most Bias.factors ReceiverPlane.fudge "
    "ReceiverPlane.limit ReceiverPlane.deepening shadow.Bias shadow.ConstantBias shadow.SlopeBias shadow.NormalOffset "
    "shadow.ReceiverPlane shadow.BiasTerms shadow.AbstractBias",
)
def _():
    own = at_a_receiver()
    slopes = jnp.stack(
        [jnp.asarray([[0.1, 0.9, 2.9], [0.4, 1.1, 3.0]]), jnp.asarray([[0.2, -0.3, 0.4], [-0.9, 0.5, 0.1]])], axis=-1
    )
    receiver = dataclasses.replace(own, slope=slopes)

    def of(x):
        sloped = shadow.SlopeBias(x[1], least=0.5 * x[3], most=x[4])
        plane = shadow.ReceiverPlane(x[5], limit=x[7], deepening=x[6])
        return shadow.Bias(x[0], sloped, x[2], plane, factors=(jnp.ones(()), x[8]))(receiver)

    return of


@row("biases of other profiles and units", [0.02, 0.6, 0.4, 0.3, 0.2, 0.7], "AdaptiveBias.epsilon shadow.AdaptiveBias")
def _():
    receiver = at_a_receiver()

    def of(x):
        offsets = [
            shadow.NormalOffset(x[2 + k], profile)
            for k, profile in enumerate(("constant", "one_minus_cosine", "across"))
        ]
        each = [
            shadow.ConstantBias(x[0], "depth"),
            shadow.SlopeBias(x[1], "one_minus_cosine"),
            shadow.AdaptiveBias(x[5]),
        ]
        return [bias(receiver) for bias in (*offsets, *each)]

    return of


_TERMS = ("one", "slope", "sine", "one_minus_cosine", "texel_size", "distance", "blocker_distance")


@row(
    "a bias that is linear in features, and its perceptron",
    [0.3, 0.5, 0.4, 0.6, 0.2, 0.7, 0.1, 0.4, -0.3, 0.5, 0.2],
    " ".join(f"Terms.{name}" for name in _TERMS) + " shadow.LinearBias shadow.PerceptronBias",
)
def _():
    receiver = at_a_receiver()
    weights = numbers(23, 2, 6, low=-1)

    def of(x):
        linear = shadow.LinearBias(dict(zip(_TERMS, x[:7], strict=True)))
        network = shadow.PerceptronBias.of(linear, [([[0.0] * 6] * 2, [0.0, 0.0])], [0.0, 0.0])
        parts = lambda one: (one.hidden[0].weight, one.hidden[0].bias, one.last)
        network = eqx.tree_at(parts, network, (weights, x[9:], x[7:9]))
        return linear(receiver).depth, network(receiver).depth

    return of


@row("biases by the receivers", [0.02, 0.03, -0.04, 0.01, 0.05, -0.03])
def _():
    own = at_a_receiver()

    def of(x):
        moved = dataclasses.replace(
            own,
            slope=own.slope * (1 + x[0]),
            cosine=own.cosine + x[1],
            depth=own.depth + 0.01 * x[2],
            depth_per_texel=own.depth_per_texel * (1 + x[3]),
            texel_size=own.texel_size * (1 + x[4]),
            distance=own.distance + x[5],
        )
        linear = shadow.LinearBias({name: jnp.asarray(0.3) for name in _TERMS})
        plane = shadow.ReceiverPlane(0.4, deepening=0.3)
        # By the texel too, whose place in the map moves with the slope here.
        adaptive = shadow.AdaptiveBias(0.2)(dataclasses.replace(moved, texel=moved.texel + 0.01 * x[0]))
        return shadow.Bias(0.8, 0.6, 0.4, plane, terms=linear)(moved), adaptive

    return of


@row("look-ups under a bias", [0.01, -0.02, 0.03, 0.004, 0.1], "shadow.look_up shadow.Lookup")
def _():
    own, light = at_a_receiver(layer=None), spot()
    plain = random_map(light)
    coarse = ShadowMap(plain.depth, light, "unorm16")

    def of(x):
        moved = dataclasses.replace(own, slope=own.slope + x[4])
        terms = shadow.BiasTerms(
            jnp.full((2, 3), x[3]), jnp.broadcast_to(x[:3], (2, 3, 3)), True, jnp.full((2, 3), 0.1) + x[3]
        )
        return [shadow.look_up(drawn, moved, terms) for drawn in (plain, coarse)]

    return of


@row("soft compares", [0.52, 0.5, 0.031, 1.3], "shadow.SoftCompare shadow.SoftKernel shadow.AbstractCompare")
def _():
    kernels = ("logistic", "linear", "smoothstep", "gaussian", "exponential")
    sides = jnp.asarray([[1.0, -1.0]])

    def of(x):
        stored = x[1] + (x[0] - x[1]) * sides
        return [SoftCompare(x[3], kernel)(stored, jnp.full((1, 2), x[1]), jnp.full((1, 2), x[2])) for kernel in kernels]

    return of


def looked_up(x, **more):
    """Look-ups that are moved along the map and in depth by three numbers."""
    places = numbers(24, 2, 3, 2) * jnp.asarray([6.0, 4.0]) + jnp.asarray([2.3, 2.4])
    depth = numbers(25, 2, 3, low=0.42, high=0.58)
    slope = 0.02 * numbers(26, 2, 3, 2, low=-1)
    if more.pop("plane", False):
        more |= {"slope": slope, "deepest": depth + 0.013}
    return Lookup(places + x[:2], depth + x[2], jnp.full((2, 3), 0.04), jnp.ones((2, 3), bool), **more)


_AT = (0.03, -0.02, 0.01)


def _filtered(name, at, of_numbers, covers, backward=False, **more):
    """A filter by its own numbers, by where receivers look up and how deep they are, by a texel of the map, and by the
    compare's width."""

    @row(name, (*at, *_AT, 0.02, 1.3), covers, backward=backward, step=1e-6, tolerance=1e-5)
    def _():
        plain = random_map(sun())

        def of(x):
            own, place, texel, width = x[:-5], x[-5:-2], x[-2], x[-1]
            drawn = ShadowMap(plain.depth.at[4:7, 3:9].add(texel), plain.light)
            return of_numbers(own)(drawn, looked_up(place, **more), SoftCompare(width))

        return of


@row("nearest look-ups", [0.01, 1.3], "shadow.Nearest")
def _():
    plain = random_map(sun())
    return lambda x: shadow.Nearest()(plain, looked_up(jnp.append(jnp.zeros(2), x[0])), SoftCompare(x[1]))


_PATTERN = lambda: shadow.vogel(3)
_filtered("bilinear look-ups", (), lambda x: shadow.Bilinear(), "shadow.Bilinear", plane=True, backward=True)
_filtered("four taps", (1.2,), lambda x: shadow.FourTap(x[0]), "FourTap.radius shadow.FourTap")
_filtered(
    "a box",
    (1.7,),
    lambda x: shadow.PercentageCloser(x[0], 2.0),
    "PercentageCloser.radius shadow.PercentageCloser",
)
_filtered("a tent", (1.8,), lambda x: shadow.Tent(x[0], 2.0), "Tent.radius shadow.Tent", plane=True)
_filtered(
    "weights of a separable kernel",
    (0.7, 0.3),
    lambda x: shadow.Separable(tuple(x)),
    "Separable.weights shadow.Separable",
)
_filtered("Castaño's kernel", (), lambda x: shadow.Castano(3), "shadow.Castano")
_filtered(
    "a disk of taps",
    (1.4,),
    lambda x: shadow.RandomDisk(x[0], _PATTERN()),
    "RandomDisk.radius shadow.RandomDisk shadow.mean_of_taps shadow.AbstractFilter",
    plane=True,
)


@row(
    "soft shadows",
    [3.1, 0.9, *_AT, 1.3],
    "PercentageCloserSoft.light_size PercentageCloserSoft.min_radius shadow.PercentageCloserSoft",
    step=1e-6,
)
def _():
    plain = random_map(dataclasses.replace(sun(), near=jnp.asarray(-2.0), far=jnp.asarray(7.0)))

    def of(x):
        least = shadow.PercentageCloserSoft(2.0, _PATTERN(), _PATTERN(), x[1], 6.0)
        own = shadow.PercentageCloserSoft(x[0], _PATTERN(), _PATTERN(), 0.0, 6.0)
        at, compare = looked_up(x[2:5]), SoftCompare(x[5])
        return own(plain, at, compare), least.find_blockers(plain, at, compare)

    return of


def _blurred(name, at, make, covers):
    @row(name, (*at, 1.7, 0.05, *_AT, 0.02), covers, step=1e-6, tolerance=1e-5)
    def _():
        plain = random_map(spot())

        def of(x):
            own, (radius, bleeding), place, texel = x[:-6], x[-6:-4], x[-4:-1], x[-1]
            drawn = ShadowMap(plain.depth.at[4:7, 3:9].add(texel), plain.light)
            blurred = make(*own, radius=radius, bleeding=bleeding)
            # And the bound of three depths at receivers between them.
            receivers = jnp.asarray([[0.25, 0.43, 0.62, 0.78, 0.91]])
            of_three = blurred.moments(jnp.asarray([0.2, 0.55, 0.7]))
            bound = blurred.bound(tuple(jnp.full((1, 5), jnp.mean(each)) for each in of_three), receivers)
            return blurred(drawn, looked_up(place), SoftCompare(1.0)), bound

        return of


_blurred(
    "variance shadow maps",
    (0.004,),
    lambda least, radius, bleeding: shadow.VarianceShadowMap(
        radius, 2.0, "tent", light_bleeding=bleeding, least_variance=least
    ),
    "VarianceShadowMap.least_variance VarianceShadowMap.radius VarianceShadowMap.light_bleeding "
    "shadow.VarianceShadowMap",
)
_blurred(
    "exponential shadow maps",
    (7.0,),
    lambda k, radius, bleeding: shadow.ExponentialShadowMap(
        radius, 2.0, "gaussian", light_bleeding=bleeding, exponent=k
    ),
    "ExponentialShadowMap.exponent ExponentialShadowMap.radius ExponentialShadowMap.light_bleeding "
    "shadow.ExponentialShadowMap",
)
_blurred(
    "exponential variance shadow maps",
    (4.0, 1.5, 0.0005),
    lambda p, n, least, radius, bleeding: shadow.ExponentialVarianceShadowMap(
        radius, 2.0, "box", light_bleeding=bleeding, positive_exponent=p, negative_exponent=n, least_variance=least
    ),
    "ExponentialVarianceShadowMap.positive_exponent ExponentialVarianceShadowMap.negative_exponent "
    "ExponentialVarianceShadowMap.least_variance ExponentialVarianceShadowMap.radius "
    "ExponentialVarianceShadowMap.light_bleeding shadow.ExponentialVarianceShadowMap",
)
_blurred(
    "moment shadow maps",
    (0.01,),
    lambda bias, radius, bleeding: shadow.MomentShadowMap(
        radius, 2.0, "tent", light_bleeding=bleeding, moment_bias=bias
    ),
    "MomentShadowMap.moment_bias MomentShadowMap.radius MomentShadowMap.light_bleeding shadow.MomentShadowMap",
)


@row("a projected texture", [1.3, 0.1, -0.2, 0.05], "shadow.ProjectiveShadow shadow.ProjectiveTexture")
def _():
    coverage, (place, normal) = jnp.round(numbers(27, *MAP)), points()

    def of(x):
        technique = shadow.ProjectiveShadow(MAP, x[0], max_blur=2.0)
        blur = Blur(technique.blur, technique.max_blur, "box")
        state = shadow.ProjectiveTexture(blur(coverage, jnp.zeros(())), spot(), jnp.zeros(1, bool), blur.margin)
        return technique.visibility(state, surface_of(place + x[1:], normal))

    return of


def _mapping(filter_, bias, width, layout=None):
    return (shadow.SingleMap() if layout is None else layout), filter_, bias, SoftCompare(width)


@row(
    "a soft compare under a point light that moves",
    [0.2, 0.9, 0.1, 0.8, 0.5, 1.2],
    "shadow.ShadowMapping shadow.SingleMap shadow.ShadowMap shadow.AbstractTechnique shadow.FittableTechnique",
    backward=True,
)
def _():
    depth, (place, normal) = numbers(28, 6, *MAP, low=0.9, high=0.97), points()

    def of(x):
        drawn = ShadowMap(depth, lamp().at(LightPose(Vector(*x[:3]), radius=lamp().radius)))
        bias = shadow.Bias(x[3], normal_offset=x[4])
        return _visibility(*_mapping(shadow.Bilinear(), bias, 20 * x[5]), drawn, surface_of(place, normal))

    return of


@row(
    "cascades that are blended and fade out",
    [0.3, 0.05, -0.04, 0.1, 0.8],
    "Cascades.blend shadow.Cascades shadow.AbstractLayout",
)
def _():
    camera = geometry.PinholeCamera((0.2, 0.5, 2.6), (0.05, 0.1, 0), (0.1, 1, 0), 41, 0.7, 6, (12, 20)).view()
    own, depth, (place, normal) = sun(), numbers(29, 2, *MAP, low=0.3, high=0.7), points()
    array = jnp.asarray

    def light(select):
        scale, offset = array([[1.6, 1.7], [1.0, 1.1]]), array([[0.1, 0.2], [0.05, 0.1]])
        ranges = array([0.7, 1.9]), array([2.6, 3.2])
        return CascadedLight(own, camera, *ranges, scale, offset, array([[0.05, 0.05]] * 2), select)

    def of(x):
        surface = surface_of(place + x[1:4], normal)
        seen = []
        for select in ("interval", "map"):
            layout = Cascades(
                2, 0.5, shadow_distance=3.2, select=select, blend=0.3, max_blend=0.5, fade=0.7, margin=1.0
            )
            layout = eqx.tree_at(lambda one: one.blend, layout, x[0])
            given = _mapping(shadow.Bilinear(), shadow.ConstantBias(x[4]), 1.3, layout)
            seen.append(_visibility(*given, ShadowMap(depth, light(select)), surface))
        return seen

    return of


@row(
    "areas of rectangles cut by two half-planes",
    [-0.43, 0.47, -0.38, 0.45, 0.7, -0.1, -0.4, -0.32],
    "shadow.SilhouetteMap",
    backward=True,
)
def _():
    turns = jnp.asarray([0.0, 2.1, 3.9])

    def of(x):
        each = lambda number: jnp.full(3, number)
        angles = x[4] + turns, x[6] + 0.3 * turns
        planes = HalfPlanes([jnp.cos(a) for a in angles], [jnp.sin(a) for a in angles], [each(x[5] - 0.2), each(x[7])])
        return cut_area(Rectangle(*map(each, x[:4])), planes)

    return of


@row("an outline's end on no edge, which moves as the other does", [0.05, -0.04])
def _():
    place = jnp.asarray([[(-0.5, 0.1), (0.2, -0.5)]] * 2)
    way = jnp.asarray([[(0.8, 0.6), (0.0, 1.0)]] * 2)
    none = jnp.zeros_like(place)

    def lines(x, moved):
        motion = jnp.broadcast_to(x - lax.stop_gradient(x), place.shape)
        first, second = _Points(place, way, motion), _Points(place[::-1] + 0.3, none, none)
        if not moved:
            # A line that moves as a whole, in value.
            first, second = (each._replace(place=each.place + x) for each in (first, second))
        else:
            first, second = _moved(first, second), _moved(second, first)
        straight = first._replace(direction=second.place - first.place)
        return _left_of(first), _left_of(straight)

    def of(x):
        return lines(x, True)

    return of, lambda x: lines(x, False)


@row(
    "parts of texels within outlines, under a sun and vertices that move",
    [31.0, 62.0, 0.02, -0.03, 0.04],
    "shadow.MapSettings shadow.MapPlan shadow.draw_shadow_map shadow.plan_crossings",
    step=1e-5,
    tolerance=1e-4,
    backward=True,
)
def _():
    mesh, size = pyramid(), (16, 24)
    edges = Edges.of(mesh)

    def moved(x):
        light = sun().at(LightPose(None, x[0], x[1], sun().angular_radius))
        own = eqx.tree_at(lambda one: one.vertices, mesh, mesh.vertices.at[0].add(x[2:]))
        return own, light, light.view().clip_vertices(own.vertices)

    # The map itself is found here: that takes long to compile.
    clip = moved(jnp.asarray([31.0, 62.0, 0.02, -0.03, 0.04]))[-1]
    corners = np.stack(np.meshgrid(np.linspace(-1, 1, 25), np.linspace(-1, 1, 17)), axis=-1)
    depths = lambda places: jnp.where(jnp.asarray(faces_at(clip, mesh.faces, places)) < 0, 1.0, 0.4)

    def of(x):
        own, light, clip = moved(x)
        outline = Outline.of(clip, own, light, edges, size)
        found = find_silhouettes(depths(centres(*size)), depths(corners), outline, 128)
        part, *_ = found.by_texel(depths(centres(*size)))
        # Corners within texels are cut short, or kept, as the outline says.
        return part

    return of


def outlined(offsets):
    """A map with outlines in two of its texels, whose half-planes have these offsets; and their directions."""
    slots = jnp.full(MAP, -1, jnp.int32).at[3, 4].set(0).at[5, 6].set(1)
    angle, two = jnp.asarray([0.3, 2.2]), lambda one: jnp.stack([one, jnp.zeros(2)])
    planes = HalfPlanes(two(jnp.cos(angle)), two(jnp.sin(angle)), jnp.stack([offsets, jnp.full(2, -1e6)]))
    found = SilhouetteMap(slots, planes, jnp.full(2, 0.3), jnp.ones(2), jnp.ones(2, bool))
    return ShadowMap(jnp.full(MAP, 0.3).at[:, 7:].set(1.0), sun(), silhouettes=found), angle


@row("means over texels with outlines", [0.13, -0.08])
def _():
    def of(x):
        drawn, _ = outlined(x)
        return drawn.silhouettes.mean_of(lambda depth: depth**2, drawn.depth), drawn.silhouettes.by_texel(drawn.depth)

    return of


@row("hard shadows of outlines within texels", [0.13, -0.08, 0.0, 0.0, 0.0], "shadow.HardCompare")
def _():
    view, depth = sun().view(), jnp.full((1, 2), 0.5)
    texel = lambda position: project(view, MAP, position)[0]
    # Points in the world whose places in the map are known.
    matrix, places = np.asarray(view.matrix), np.array([(4.3, 3.6), (6.2, 5.1)]) / np.array(MAP[::-1]) * 2 - 1
    known = [np.linalg.solve(matrix[:3, :3], np.append(place, 0) - matrix[:3, 3]) for place in places]
    start = jnp.asarray(known)[None]

    def seen(offsets, moves, along):
        """With points that move in the world, and outlines so far away along the map."""
        _, angle = outlined(offsets)
        drawn, _ = outlined(offsets + jnp.cos(angle) * along[..., 0] + jnp.sin(angle) * along[..., 1])
        each = start + moves
        at = Lookup(texel(each), depth, 0.08 * depth, jnp.ones((1, 2), bool), position=each)
        return shadow.Bilinear()(drawn, at, shadow.HardCompare())

    # To a look-up that moves, outlines move the other way; what only depends on where texels lie has no derivative.
    # All points move alike along the map.
    opposite = lambda x: -(texel(start + x[2:]) - texel(start))[0]
    return lambda x: seen(x[:2], x[2:], jnp.zeros((2, 2))), lambda x: seen(x[:2], jnp.zeros(3), opposite(x))


@row("depths as a map stores them", [0.02, -0.03, 0.04, 0.31, 0.62])
def _():
    mesh, test, places = pyramid(), DepthTest("unorm16"), centres(6, 9)
    light = sun()
    clip = lambda x: light.view().clip_vertices(mesh.vertices.at[3].add(x[:3]))
    face = jnp.asarray(faces_at(clip(jnp.zeros(3)), mesh.faces, places))

    def bent(x):
        plain = clip(x)
        return plain.at[:, 3].add(0.1 * plain[:, 1]), plain

    settings = shadow.MapSettings((6, 9), depth_format="unorm16")

    def of(x):
        seen = Fragments(face, test.decode(test.encode(jnp.full((6, 9), 0.4))))
        stored = _stored(seen, clip(x), mesh.faces, light.view().tile, settings)
        return midpoint(x[3:4], x[4:], test), unwarped_depth(face, *bent(x), mesh.faces, test), stored

    def smooth(x):
        warped, plain = bent(x)
        of_warped = raster.interpolate_depth(raster.barycentrics(face, warped, mesh.faces), plain, mesh.faces)
        own = raster.interpolate_depth(raster.barycentrics(face, plain, mesh.faces), plain, mesh.faces)
        return (x[3:4] + x[4:]) / 2, jnp.minimum(of_warped, 1), own

    return of, smooth
