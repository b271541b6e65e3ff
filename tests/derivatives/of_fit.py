"""What fits minimise, and their changes of variables."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from scenes import Waves

from diffshadow import fit, geometry, shadow
from diffshadow.fit import Loss
from diffshadow.fit._large_steps import LargeSteps
from diffshadow.fit._moving_lights import MovingLights
from diffshadow.fit._own_loss import OwnLoss, Seen
from diffshadow.fit._parameters import Parameter, Parameters
from diffshadow.fit._regularizers import Regularizers
from diffshadow.fit._shape_program import Level, ShapeProgram
from diffshadow.fit._solve import _rows, _rows_of_own
from diffshadow.fit._train import _bounded
from diffshadow.fit.problems import ShapeView, together
from diffshadow.fit.problems._aligned import Receivers
from diffshadow.fit.problems._arranged import weighted_difference
from diffshadow.fit.problems._blur import blurred
from diffshadow.fit.problems._joint import Joint
from diffshadow.fit.problems._pose import cone_fraction
from diffshadow.shading import Phong
from diffshadow.shadow import ShadowMap
from diffshadow.shadow.silhouettes import HalfPlanes, SilhouetteMap

from . import numbers, row, surface_of
from .of_geometry import POINTS, PYRAMID, SAMPLES, pyramid, spot, sun
from .of_shadow import points, random_map

_ERRORS = (0.31, 0.12, 0.28, 0.05)
_SHARES = (0.2, 0.4, 0.1, 0.3)


def _smooth_cvar(errors, shares, power, fraction):
    """The least of the documented formula over thresholds, found by a fine search and a parabola."""
    log_t = np.linspace(-6, 0, 3001)
    t = np.exp(log_t)[:, None]
    of = lambda t: (
        t[:, 0] + t[:, 0] / (power * fraction) * jnp.sum(shares * jnp.logaddexp(0.0, power * (errors / t - 1)), axis=1)
    )
    near = lax.stop_gradient(jnp.argmin(of(t)))
    low, middle, high = of(jnp.exp(log_t[0] + (near + jnp.arange(-1, 2)) * (log_t[1] - log_t[0]))[:, None])
    return middle - (high - low) ** 2 / (8 * (high - 2 * middle + low))


@row("losses of several images", _ERRORS, "fit.Loss", tolerance=1e-4)
def _():
    shares = jnp.asarray(_SHARES)
    losses = [
        Loss("mean"),
        Loss("worst"),
        Loss("worst", power=jnp.asarray(7.0)),
        Loss("cvar", fraction=0.35),
        Loss("cvar", fraction=0.35, power=jnp.asarray(7.0)),
    ]
    # The loss is homogeneous, so that it is the weighted sum of errors; the weights are its derivative.
    of = lambda errors: [jnp.sum(lax.stop_gradient(loss.weights(errors, shares)) * errors) for loss in losses]

    def documented(errors):
        order = jnp.argsort(-errors)
        before = jnp.cumsum(shares[order]) - shares[order]
        taken = jnp.clip(0.35 - before, 0, shares[order])
        return [
            jnp.sum(shares * errors),
            jnp.max(errors),
            jnp.sum(shares * errors**7) ** (1 / 7),
            jnp.sum(taken * errors[order]) / 0.35,
            _smooth_cvar(errors, shares, 7.0, 0.35),
        ]

    return of, documented


@row("how the weights of images change", _ERRORS, tolerance=1e-5)
def _():
    shares = jnp.asarray(_SHARES)
    losses = [Loss("worst", power=jnp.asarray(7.0)), Loss("cvar", fraction=0.35, power=jnp.asarray(7.0))]

    def of(errors):
        """Half the second derivative of the loss, times errors that change along x: by the rows, and by differences of
        the weights."""
        change = errors - lax.stop_gradient(errors)
        fixed = lax.stop_gradient(errors)
        found = []
        for loss in losses:
            rows = loss.curvature_rows(fixed, shares, jnp.eye(4))
            found.append(loss.weights(fixed, shares) + 2 * rows.T @ (rows @ change))
        return found

    return of, lambda errors: [loss.weights(errors, shares) for loss in losses]


def _joint(loss):
    """Two images of unequal masks that are smooth functions of two numbers, and the bounds of these."""
    place, normal = points()
    known = []
    for seed, kept in ((60, 3), (61, 5)):
        mask = jnp.arange(6).reshape(2, 3) < kept
        seen = surface_of(place, normal)
        technique = Waves(jnp.asarray(0.7), jnp.asarray(2.1))
        known.append(fit.TechniqueProblem(technique, random_map(sun()), seen, numbers(seed, 2, 3), mask))
    bounds = [Parameter("first", 0.7, 0.2, 1.9), Parameter("second", 2.1, 1.0, 4.0)]
    return Joint.of(known, loss), Parameters.of(bounds)


@row("the losses that solvers descend", [0.35, 0.42], tolerance=1e-5)
def _():
    losses = [None, Loss("worst", power=jnp.asarray(7.0)), Loss(false_shadow=2.0, false_light=0.5)]
    joints = [_joint(loss) for loss in losses]

    def of(x):
        """To first order in the numbers, as least squares of residuals and their Jacobian have them."""
        fixed = lax.stop_gradient(x)
        return [jnp.sum(_rows(joint, known, fixed, x - fixed)[0] ** 2) for joint, known in joints]

    at = lambda joint, known, x: joint.losses(known.put(joint.subject, known.at(x))).compared
    return of, lambda x: [at(joint, known, x) for joint, known in joints]


@row("users' losses that solvers descend", [0.35, 0.42], step=1e-2, tolerance=1e-2)
def _():
    number = lambda seen, truth, mask: jnp.sum(jnp.abs(seen - truth)) / jnp.sum(mask)
    joints = [_joint(lambda seen, truth, mask: seen - truth), _joint(number)]

    def of(x):
        fixed = lax.stop_gradient(x)
        first, second = (_rows_of_own(joint, known, fixed, x - fixed)[0] for joint, known in joints)
        # They are computed in float32.
        return jnp.sum(first**2).astype(float), jnp.sum(second).astype(float)

    def smooth(x):
        rows = [joint.rows(known.put(joint.subject, known.at(x)))[0] for joint, known in joints]
        return jnp.sum(jnp.stack(rows[0]) ** 2) / 2, jnp.mean(jnp.stack(rows[1]))

    return of, smooth


@row("differences of visibility with factors", [0.3, -0.4])
def _():
    return lambda x: Loss("mean", false_shadow=2.0, false_light=0.5).signed(x)


@row(
    "differences of images under weights and masks",
    [0.3, 0.6, 0.2],
    "fit.AbstractProblem fit.PoseProblem fit.TechniqueProblem fit.PictureProblem",
)
def _():
    weight, reference = jnp.asarray([[0.0, 0.3, 1.0], [1.0, 0.7, 0.0]]), numbers(41, 2, 3)
    image = numbers(42, 2, 3)

    def of(x):
        seen = image.at[0, 1].set(x[0]).at[1, 0].set(x[1]).at[1, 1].set(x[2])
        return weighted_difference(seen, reference, weight)

    return of


@row("a user's loss under a mask", [0.3, 0.6], step=1e-2, tolerance=1e-3)
def _():
    mask, reference = jnp.asarray([[False, True, True], [True, False, True]]), numbers(43, 2, 3)
    image = numbers(44, 2, 3).at[0, 0].set(jnp.nan)
    loss = OwnLoss(lambda seen, truth, counts: jnp.sum(jnp.where(counts, seen - truth, 0) ** 2) / 3, True)

    def of(x):
        # Pixels that do not count follow the numbers too.
        moved = image.at[0, 1].set(x[0]).at[1, 0].set(x[1]).at[1, 1].set(1e9 * x[0])
        # It is computed in float32.
        return loss.of_rows(loss.rows(Seen.of(moved, reference, mask))).astype(float)

    return of


@row("images under a blur", [0.3, 0.6, 1.3])
def _():
    image = numbers(45, 12, 20)
    return lambda x: blurred(image.at[3, 4].set(x[0]).at[11, 19].set(x[1]), x[2])


@row("bounded numbers and their inverse", [0.4, -1.1, 0.3], "fit.Parameters fit.Parameter")
def _():
    given = [
        Parameter(name, 2.0, low, high, offset=offset)
        for name, low, high, offset in (("a", 1.0, 4.0, 0.0), ("b", -2.0, 9.0, 1.0), ("c", 0.0, 3.0, 0.0))
    ]
    known = Parameters.of(given)
    half = known.at(jnp.asarray([0.3, 0.6, 0.4]))
    return lambda x: (
        known.to_bounded(x),
        known.to_free(half + 0.1 * x),
        _bounded(x, jnp.asarray([0.5, -jnp.inf, 2.0])),
    )


@row("numbers put into a technique", [0.4, 1.7], "fit.with_values")
def _():
    technique = shadow.ShadowMapping(shadow.Tent(1.0, 3.0), shadow.Bias(0.5))

    def of(x):
        moved = fit.with_values(technique, ["bias.constant", "filter.radius"], x)
        return moved.bias.constant.value, moved.filter.radius

    return of


@row(
    "a scene as it is arranged",
    [31.0, 62.0, 0.2, 0.9, 1.1, 2.2, 12.0, 0.4],
    "fit.Arrangement geometry.Scene",
    step=1e-4,
)
def _():
    technique = shadow.ShadowMapping(shadow.Bilinear(), shadow.Bias(0.5))
    camera = geometry.PinholeCamera((1.2, 1.9, 2.5), (0.1, 0.2, 0), (0.1, 1, 0), 40, 0.3, 9, (12, 20))
    scene = geometry.Scene([pyramid(), pyramid(0.0)], camera, [sun(), spot()])
    arrangement = fit.Arrangement.of(technique, scene.lights, scene.meshes).pictured(scene, Phong(), 0.3)
    paths = [
        *("lights.0.azimuth", "lights.1.elevation", "lights.1.position.x", "meshes.1.translate.y"),
        *("camera.eye.x", "camera.eye.z", "meshes.0.turn.z", "technique.bias.constant"),
    ]
    where = jnp.asarray(POINTS)

    def of(x):
        moved = fit.with_values(arrangement, paths, x)
        placed = moved.placed(scene)
        lit = [light.towards(where, jnp.asarray(SAMPLES)) for light in placed.lights]
        return lit, placed.mesh.vertices, placed.mesh.corner_normals, placed.camera.eye, moved.technique.bias.constant

    return of


@row("the mean square error of a technique under a mask", [0.4, 0.9])
def _():
    place, normal = points()
    mask, drawn = jnp.asarray([[True, False, True], [True, True, False]]), random_map(sun())
    technique = shadow.ShadowMapping(shadow.Nearest(), shadow.Bias(0.4), shadow.SoftCompare(2.0))
    known = fit.TechniqueProblem(technique, drawn, surface_of(place, normal), numbers(46, 2, 3), mask)

    def of(x):
        moved = fit.with_values(technique, ["bias.constant", "bias.slope"], x)
        return known.mean_square_error(moved), known.residual(moved)

    return of


@row("the part of a texel that an outline lights", [0.13, -0.08])
def _():
    slots, depth = jnp.full((2, 3), -1, jnp.int32).at[0, 1].set(0).at[1, 2].set(1), jnp.full((2, 3), 0.3)
    angle = jnp.asarray([0.3, 2.2])
    two = lambda one: jnp.stack([one, jnp.zeros(2)])
    off = jnp.asarray(0.0)
    receivers = Receivers(jnp.full((2, 3), 0.6), jnp.ones((2, 3), bool), jnp.ones((2, 3)), off)

    def of(x):
        planes = HalfPlanes(two(jnp.cos(angle)), two(jnp.sin(angle)), jnp.stack([x, jnp.full(2, -1e6)]))
        outlines = SilhouetteMap(slots, planes, jnp.full(2, 0.3), jnp.ones(2), jnp.ones(2, bool))
        return receivers.seen(ShadowMap(depth, sun(), silhouettes=outlines))

    return of


@row("the cone of a light at pixels", [31.0, 62.0, 0.2], step=1e-4)
def _():
    place, normal = points()

    def of(x):
        light = spot(inner_angle=11.0)
        moved = light.at(geometry.LightPose(light.pose().position, x[0], x[1], x[2]))
        return cone_fraction(moved, surface_of(place + x[2], normal))

    return of


def _shape(x):
    vertices = PYRAMID[0].copy()
    vertices.reshape(-1)[: len(x)] += x
    return vertices


_STILL = (0.03, -0.02, 0.05, -0.04, 0.02)


def _host(name, of, at=_STILL, **more):
    row(name, at, on_host=True, step=1e-6, **more)(lambda: of)


def _penalty(*weights):
    faces = PYRAMID[1].copy()
    # Neighbours that are wound otherwise have the same angle between them.
    faces[0] = faces[0, ::-1]
    penalty = Regularizers(PYRAMID[0], faces, *weights)

    def of(x):
        value, gradient = penalty(_shape(x))
        return value, gradient.reshape(-1)[: len(x)]

    return of


_host("folds of a mesh", _penalty(2.0, 0.0))
_host("lengths of edges, and folds", _penalty(0.4, 3.0))

_WEIGHTS = np.random.default_rng(50).normal(size=PYRAMID[0].shape)


def _loss_of(vertices):
    """A smooth function of vertices, and its derivative."""
    return np.sum(_WEIGHTS * np.sin(2 * vertices)), 2 * _WEIGHTS * np.cos(2 * vertices)


def _large_steps():
    free = np.array([True, True, False, True])
    large = LargeSteps(*PYRAMID, free, 3.0)
    start = large.u_of(PYRAMID[0])

    def of(x):
        moved = start.copy()
        moved.reshape(-1)[: len(x)] += x
        value, gradient = _loss_of(large.vertices_of(moved))
        return value, large.gradient_of(gradient).reshape(-1)[: len(x)]

    return of


_host("large steps", _large_steps())


def _mirrored():
    # A plane off the origin, whose normal is of no unit length; the first and the second vertex are partners.
    plane = (2.0, -1.0, 0.5, 0.7)
    partner = np.array([1, 0, 2, 3])
    level = Level(PYRAMID[0], PYRAMID[1], np.ones(4, bool), None, None, partner)
    program = SimpleNamespace(problem=SimpleNamespace(symmetry=plane))

    def of(x):
        value, gradient = _loss_of(ShapeProgram.mirrored(program, level, _shape(x)))
        return value, ShapeProgram.mirrored_gradient(program, level, gradient).reshape(-1)[: len(x)]

    return of


_host("a shape that is its own mirror image", _mirrored())


def _lights():
    """The pose of a spot light, by angles that the shape sees."""
    view = ShapeView(spot(), surface_of(*points()), np.zeros((2, 3)), moves=True)
    group = together([view])

    def of(x):
        moving = MovingLights.of([group], np.array([0.1, 0.2, 0.3]))
        start = moving.start
        moved = moving.moved(start, np.concatenate([x, np.zeros(len(start) - len(x))]))
        at = moving.poses(moved)[0]
        leaves, treedef = jax.tree.flatten(at)
        weights = [1.0, -0.7, 0.4, 0.3, -0.2, 0.0]
        value = sum(weight * float(np.sin(leaf[0])) for weight, leaf in zip(weights, leaves, strict=True))
        slopes = [weight * np.cos(np.asarray(leaf)) for weight, leaf in zip(weights, leaves, strict=True)]
        return value, moving.in_degrees([jax.tree.unflatten(treedef, slopes)])[: len(x)]

    return of


row("lights that move with a shape", (0.3, -0.4, 0.2, 0.5, -0.6), on_host=True, step=1e-4)(_lights)
