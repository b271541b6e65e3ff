"""Settings of fits: solver, annealing, loss, and reported results."""

import math
from typing import Annotated, Any, Literal

from annotated_types import Len

from ._settings import At, Form, Limits, Settings, Unit
from .maps import SoftKernel, Width
from .quantities import MAX_TEXELS, Coordinate, Distance, Factor, PixelPointCount, Size

SolverName = Literal["levenberg_marquardt", "dogleg", "bfgs", "lbfgs", "adam"]
Over = Literal["mean", "worst", "cvar"]

FEWEST_POINTS = 3
"""The minimum number of points of a front."""
PIXELS = 1 << 16
"""The default maximum of pixels in a step of a fit of a technique: 256 x 256."""
BLUR = 3.0
"""The default of a fit's last standard deviation, in pixels."""
MOST_SHADOW_POINTS = 1 << 20
"""The default maximum of points within its pixels at which a fit of lights or meshes, or a fit to a picture, looks up
shadows."""
# The largest standard deviation, as a fraction of the image's shorter side.
_WIDEST = 1 / 8


def widest_blur(*sides: int) -> float:
    """The largest standard deviation for images of these `sides`, in pixels."""
    return max(_WIDEST * min(sides), BLUR)


_Tolerance = Annotated[float, Limits(0, 1, above_low=True, below_high=True)]
Excess = Annotated[float, Limits(0, 10, above_low=True)]
"""The tolerated increase of the error, as a fraction of the best error."""
Blur = Annotated[float, Limits(0, MAX_TEXELS), Unit("pixels")]


class Solver(Settings):
    """The optimizer."""

    type: Annotated[SolverName, At("name"), "the method"] = "levenberg_marquardt"
    # About a day, at a second per step.
    max_steps: Annotated[int, Limits(1, 100_000), Unit("steps"), "maximum number of steps in a phase"] = 30
    rtol: Annotated[_Tolerance, "relative change at which a phase ends"] = 1e-4
    atol: Annotated[_Tolerance, "absolute change at which a phase ends"] = 1e-6
    learning_rate: Annotated[
        float,
        Limits(0, math.pi, above_low=True),
        "for adam only: length of its first steps, in units where the bounds are pi apart",
    ] = 0.05
    noise: Annotated[
        float | None,
        Limits(0, 1, below_high=True),
        "fraction of the loss by which it jumps; default: 0.25 in fits that move lights or meshes, else 0",
    ] = None


class Anneal(Settings):
    """The soft compare's width during a fit: from `start` to `end` in geometric steps."""

    start: Annotated[Width, "width in the first phase, in texels"] = 2.0
    end: Annotated[Width, "width in the last phase, in texels"] = 0.05
    phases: Annotated[int, Limits(1, 100), "number of phases"] = 4
    kernel: Annotated[SoftKernel, "shape of the soft compare's step"] = "logistic"
    ascending = (("end", "start", True),)


class AnyLoss(Settings):
    """The quantity that a fit minimises."""

    type: Any


class Loss(AnyLoss):
    """The number that a fit minimises, made from the mean square errors of its views."""

    type: Literal["squares"] = "squares"
    over: Annotated[Over, "the mean over all pixels, the worst view, or the mean of the worst views"] = "mean"
    fraction: Annotated[
        float,
        Limits(0, 1, above_low=True),
        "for cvar: the fraction of all pixels that the worst views have",
    ] = 0.1
    false_shadow: Annotated[Factor, "factor of squared errors that are too dark"] = 1.0
    false_light: Annotated[Factor, "factor of squared errors that are too light"] = 1.0


class Search(Settings):
    """How a fit searches."""

    blurs: Annotated[
        tuple[Blur, ...] | None,
        Form("a list of numbers that fall", "[24, 3]"),
        Unit("pixels"),
        "for lights and meshes: standard deviation of the Gaussian under which images are compared, in each phase; "
        "default: from an eighth of the image's shorter side to 3, in steps of about a third",
    ] = None
    multistart: Annotated[
        int,
        Limits(1, 1024),
        Unit("starts"),
        At("starts"),
        "number of starts: the initial values, and others within the bounds",
    ] = 1
    # Each evaluation draws the map again.
    evaluations: Annotated[
        int,
        Limits(1, 100_000),
        "for numbers that lay out the map: evaluations of the error in a search, for each parameter",
    ] = 30
    pixels: Annotated[
        int,
        Limits(1, 1 << 40),
        Unit("pixels"),
        "for techniques: maximum number of pixels of all views in a step of the fit; if more count, a random sample",
    ] = PIXELS
    devices: Annotated[
        int,
        Limits(0, 4096),
        Unit("devices"),
        "devices that share the views of a fit of a technique; 0 for all that JAX sees",
    ] = 1


class Sureness(Settings):
    """The results of a fit about the values near the best."""

    intervals: Annotated[
        tuple[Excess, ...],
        # Each fraction takes as long as the fit, for every parameter.
        Len(0, 16),
        Form("a list of at most 16 fractions", "[0.01, 0.05]"),
        At("within"),
        "fractions: for each, how far every parameter may move, with the others fitted again, before the error "
        "exceeds the best by this fraction",
    ] = ()
    tolerance: Annotated[Excess, "for prefer: how far the error may exceed the best, as a fraction of the best"] = 0.01
    front: Annotated[
        int,
        Limits(0, 101),
        Unit("points"),
        f"points of the front of false shadow against false light, {FEWEST_POINTS} or more; default: not found",
    ] = 0


class Fit(Search, Sureness):
    """The search of a fit, and its report."""

    points: Annotated[
        PixelPointCount | None,
        "where lights or meshes move: points within each pixel at which shadows are looked up; default: more where "
        "texels are narrower than pixels",
    ] = None


class ShapePhase(Settings):
    """A phase of a fit of a shape."""

    strength: Annotated[
        float,
        Limits(0, 1e6),
        "strength of the smoothing between the steps of neighbouring vertices: λ of large steps; 0 for none",
    ] = 20.0
    rate: Annotated[
        float,
        Limits(0, 1, above_low=True),
        "length of the first steps, as a fraction of the longest side of the shadows; it falls to a twentieth",
    ] = 0.05
    steps: Annotated[int, Limits(1, 100_000), Unit("steps"), "number of steps"] = 150
    blur: Annotated[Blur, "standard deviation of the Gaussian under which images are compared"] = 1.0
    # Each split makes four triangles of one. A sphere of 20 has 1.3 million after 8.
    subdivisions: Annotated[
        int, Limits(0, 8), "number of times that each triangle is split in four before the phase"
    ] = 0
    light_rate: Annotated[
        float,
        Limits(0, 90),
        Unit("degrees"),
        "length of the first steps of lights that move, as seen from the shape; it falls to a twentieth",
    ] = 0.3
    normal_consistency: Annotated[
        float, Limits(0, 1e6), "weight of the mean of 1 - cos of the angles between neighbouring faces' normals"
    ] = 0.0
    edge_length: Annotated[
        float,
        Limits(0, 1e6),
        "weight of the mean square of edges' lengths, as a fraction of its value before the phase",
    ] = 0.0


PHASES = (
    {"strength": 20.0, "rate": 0.0225, "steps": 30, "normal_consistency": 1e-2},
    {"strength": 5.0, "rate": 0.0225, "steps": 100, "normal_consistency": 1e-2},
    {"strength": 2.0, "rate": 0.015, "steps": 180, "normal_consistency": 1e-3},
)
"""Phases of a fit of a shape from within its visual hull. Missing fields have their defaults."""
Screen = Literal["facing", "below"]


class Shape(Settings):
    """A fit of all vertices of a mesh to its shadows on screens. Each light has one screen, behind the mesh."""

    screen: Annotated[
        Screen, "surfaces that shadows fall on: screens that face their lights, or a level screen below"
    ] = "facing"
    resolution: Annotated[Size, Unit("pixels"), "[height, width] of images, and of shadow maps in texels"] = (128, 128)
    extent: Annotated[
        Distance | None, "side of the square across the light that an image shows; default: 2.2 radii of all meshes"
    ] = None
    symmetry: Annotated[
        Literal["x", "y", "z"] | None,
        "axis across which the shape stays its own mirror image, about the start's middle",
    ] = None
    pinned: Annotated[Coordinate | None, "vertices of the start below this height do not move"] = None
    moves: Annotated[
        tuple[Annotated[int, Limits(0, 1 << 16)], ...],
        Form("a list of whole numbers", "[0, 2]"),
        "indices of the scene's lights, from 0, that are fitted together with the shape",
    ] = ()
    off: Annotated[
        float,
        Limits(0, 45),
        Unit("degrees"),
        "for traced shadows: angle between the start of these lights and their position in the scene",
    ] = 0.0
    seconds: Annotated[
        float, Limits(0, 86_400), Unit("seconds"), "time between checkpoints, from which a stopped fit continues"
    ] = 10.0
