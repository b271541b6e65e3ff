"""Shadows of engines, from maps that are made by hand."""

import jax.numpy as jnp

from diffshadow.geometry import MatrixLight
from diffshadow.shadow import BabylonJs, Bevy, EngineMap, GodotCompatibility, PlayCanvas, SoftCompare, ThreeJs
from diffshadow.shadow.engines._bevy import camera_of as bevy_camera_of
from diffshadow.shadow.engines._cameras import EngineCameras
from diffshadow.shadow.engines._engine_map import Corners
from diffshadow.shadow.engines._godot import camera_of as godot_camera_of
from diffshadow.shadow.engines._playcanvas import camera_of

from . import numbers, row, surface_of
from .of_geometry import lamp, spot, sun
from .of_shadow import points


def _shadowed(name, at, make, light, covers="", layers=(), low=0.35, high=0.65, moves=True, **of_map):
    """An engine's shadows by its numbers, and by where receivers are if these move."""

    @row(name, (*at, 0.1, -0.2, 0.05) if moves else at, covers, step=1e-6, tolerance=1e-5)
    def _():
        depth, slope = numbers(60, *layers, 12, 12, low=low, high=high), numbers(61, *layers, 12, 12, low=0, high=0.01)
        state = EngineMap(
            depth, light(), jnp.ones(1), jnp.ones(1, bool), slope=slope, drawn_with=jnp.zeros(()), **of_map
        )
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


def _cameras(of):
    view = spot().view()
    return lambda: EngineCameras.of([of(MatrixLight(view.world_to_eye, view.eye_to_clip))], True)


_PLAYCANVAS = "PlayCanvas.shadow_bias PlayCanvas.normal_offset_bias shadow.PlayCanvas"
_playcanvas = lambda *x: PlayCanvas(*x, compare=SoftCompare(2.0), shadow_type="PCF5_32F", resolution=(12, 12))
_shadowed("PlayCanvas under a spot light", (0.1, 0.03, 0.8), _playcanvas, _cameras(camera_of), _PLAYCANVAS)
_shadowed("PlayCanvas under a point light", (0.1, 0.03), _playcanvas, lamp, layers=(6,), low=0.1, high=0.5)

_BEVY = "Bevy.shadow_depth_bias Bevy.shadow_normal_bias shadow.Bevy"
_bevy = lambda *x: Bevy(*x, compare=SoftCompare(2.0), resolution=(16, 16))
_shadowed("Bevy under a spot light", (0.02, 0.3), _bevy, _cameras(bevy_camera_of), _BEVY, unit="reversed")

# Receivers move at the corners of their only face, whose normals differ.
_CORNERS = Corners(
    jnp.array([[(-4.0, 0, -4), (4, 0, -4), (0, 0, 5)]]), jnp.array([[(0.1, 0.99, 0), (0, 1, 0), (0, 0.9, 0.4)]])
)
_GODOT = "GodotCompatibility.shadow_bias GodotCompatibility.shadow_normal_bias shadow.GodotCompatibility"
_godot = lambda *x: GodotCompatibility(*x, compare=SoftCompare(2.0), resolution=(12, 12))
_normal = lambda normal, *x: _godot(0.0, normal, *x)
_lamp = {"layers": (6,), "low": 0.1, "high": 0.5, "unit": "distance", "corners": _CORNERS}
_shadowed("Godot under a point light", (0.05, 0.2), _godot, lamp, _GODOT, **_lamp)
_spot = {"unit": "reversed", "corners": _CORNERS}
_shadowed("Godot under a spot light", (0.2,), _normal, _cameras(godot_camera_of), **_spot)
