"""Shadows of engines, from maps that are made by hand."""

import jax.numpy as jnp

from diffshadow.geometry import MatrixLight
from diffshadow.shadow import BabylonJs, EngineMap, PlayCanvas, SoftCompare, ThreeJs
from diffshadow.shadow.engines._cameras import EngineCameras
from diffshadow.shadow.engines._playcanvas import camera_of

from . import numbers, row, surface_of
from .of_geometry import lamp, spot, sun
from .of_shadow import points


def _shadowed(name, at, make, light, covers="", layers=(), low=0.35, high=0.65, moves=True):
    """An engine's shadows by its numbers, and by where receivers are if these move."""

    @row(name, (*at, 0.1, -0.2, 0.05) if moves else at, covers, step=1e-6, tolerance=1e-5)
    def _():
        depth, slope = numbers(60, *layers, 12, 12, low=low, high=high), numbers(61, *layers, 12, 12, low=0, high=0.01)
        state = EngineMap(depth, light(), jnp.ones(1), jnp.ones(1, bool), slope=slope, drawn_with=jnp.zeros(()))
        place, normal = points()
        count = len(at)
        by = (lambda x: x[count:]) if moves else (lambda x: 0.0)
        return lambda x: make(*x[:count]).visibility(state, surface_of(place + by(x), normal))


_THREE = "ThreeJs.bias ThreeJs.normal_bias ThreeJs.radius shadow.ThreeJs"
_three = lambda *x: ThreeJs(*x, compare=SoftCompare(2.0), side="double", resolution=(12, 12))
_shadowed("three.js under a sun", (-0.02, 0.03, 1.3, 0.8), _three, sun, _THREE)
_shadowed("three.js under a point light", (-0.02, 0.03, 1.3), _three, lamp, layers=(6,), low=0.88, high=0.95)


def _babylon(name, **more):
    given = {"compare": SoftCompare(2.0), "float_maps": True, "resolution": (12, 12), "filter": name}
    return lambda *x: BabylonJs(**given, **dict(zip(more["names"], x, strict=True)))


def _of_babylon(name, light=sun, covers="", **numbers_of):
    title = f"Babylon.js, {name}, under a {light.__name__}"
    # The turn of the taps of PCSS is a hash of where receivers are.
    _shadowed(
        title, tuple(numbers_of.values()), _babylon(name, names=tuple(numbers_of)), light, covers, moves=name != "PCSS"
    )


_of_babylon(
    "POISSONSAMPLING",
    covers="BabylonJs.bias BabylonJs.blur_scale shadow.BabylonJs shadow.EngineMap shadow.AbstractEngineShadows",
    bias=0.02,
    blur_scale=1.7,
    frustum_edge_falloff=0.9,
)
_of_babylon("PCF", spot, bias=0.02, darkness=0.2)
_of_babylon(
    "PCSS",
    covers="BabylonJs.contact_hardening_light_size_uv_ratio",
    bias=0.02,
    contact_hardening_light_size_uv_ratio=0.2,
)
_of_babylon("EXPONENTIALSHADOWMAP", covers="BabylonJs.depth_scale", bias=0.02, depth_scale=7.0)
_of_babylon("CLOSEEXPONENTIALSHADOWMAP", bias=0.02, depth_scale=7.0)


def _cameras():
    view = spot().view()
    return EngineCameras.of([camera_of(MatrixLight(view.world_to_eye, view.eye_to_clip))], True)


_PLAYCANVAS = "PlayCanvas.shadow_bias PlayCanvas.normal_offset_bias shadow.PlayCanvas"
_playcanvas = lambda *x: PlayCanvas(*x, compare=SoftCompare(2.0), shadow_type="PCF5_32F", resolution=(12, 12))
_shadowed("PlayCanvas under a spot light", (0.1, 0.03, 0.8), _playcanvas, _cameras, _PLAYCANVAS)
_shadowed("PlayCanvas under a point light", (0.1, 0.03), _playcanvas, lamp, layers=(6,), low=0.1, high=0.5)
