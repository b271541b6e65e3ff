"""The settings of three.js' goldens.

Each shows one rule at its most sensitive: front faces and the ground cast, and the bias is about half of what ends
the acne, so that a bias off by a tenth changes many pixels.
"""

from typing import Any

from _engine_scene import CAMERA, SIZE

# Front faces cast, and the ground too.
FRONT = [
    {"mesh": "ground", "shadowSide": "front"},
    {"mesh": "blob", "shadowSide": "front"},
    {"mesh": "box", "shadowSide": "front"},
    {"mesh": "torus", "shadowSide": "front"},
]
DEFAULT = [{"mesh": name["mesh"]} for name in FRONT]
DOUBLE = [{**mesh, "shadowSide": "double"} for mesh in FRONT]
# Each mesh another material. The box has no normals, and the torus only casts.
MIXED = [
    {"mesh": "ground", "side": "double"},
    {"mesh": "blob", "side": "back"},
    {"mesh": "box", "side": "double", "normals": None},
    {"mesh": "torus", "receives": False},
]
UNCAST = [{"mesh": "ground", "casts": False, "side": "double"}, *FRONT[1:3], {"mesh": "torus", "casts": False}]

SUN = {
    "type": "directional",
    "position": [-1.6, 3.0, 1.4],
    "target": [0.0, 0.2, 0.0],
    "mapSize": 128,
    "camera": {"left": -1.9, "right": 1.9, "top": 1.7, "bottom": -1.7, "near": 1.0, "far": 6.5},
}
# Smaller than the scene on every side: parts of the ground lie beside it, before its near and beyond its far plane.
SMALL = {"left": -0.9, "right": 1.1, "top": 1.2, "bottom": -0.7, "near": 3.0, "far": 3.9}
SPOT = {
    "type": "spot",
    "position": [-1.3, 2.6, 1.2],
    "target": [0.05, 0.0, 0.0],
    "angle": 0.45,
    "mapSize": 128,
    "camera": {"near": 0.8, "far": 7.0},
}
LAMP = {"type": "point", "position": [0.1, 1.35, 0.25], "mapSize": 96, "camera": {"near": 0.15, "far": 5.0}}


def three_cases() -> dict[str, dict[str, Any]]:
    """The jobs of `engines.draw` by name, with names in place of meshes."""
    cases: dict[str, dict[str, Any]] = {}

    def add(name: str, type_: str, light: dict, meshes: list = FRONT, is_reversed: bool = False, **more: Any) -> None:
        cases[name] = {
            "engine": "three",
            **SIZE,
            "meshes": meshes,
            "light": {**light, **more},
            "shadowType": type_,
            "reversedDepthBuffer": is_reversed,
            "camera": CAMERA,
        }

    add("directional_basic_bias", "Basic", SUN, bias=-0.0015)
    add("directional_pcf_bias", "PCF", SUN, bias=-0.002)
    add("directional_pcf_radius_4", "PCF", SUN, bias=-0.004, radius=4.0)
    add("directional_pcfsoft_radius_4", "PCFSoft", SUN, bias=-0.004, radius=4.0)
    add("directional_pcf_no_bias", "PCF", SUN)
    # The engine's own frustum and the bias that many examples have: a quarter of a world unit.
    wide = {key: value for key, value in SUN.items() if key != "camera"}
    add("directional_pcf_default_frustum", "PCF", wide, bias=-0.0005, mapSize=512)
    add("directional_pcf_away", "PCF", SUN, bias=0.002)
    add("directional_pcf_normal_bias", "PCF", SUN, normalBias=0.01, radius=1.5)
    add("directional_basic_normal_bias", "Basic", SUN, normalBias=0.008)
    add("directional_pcf_both_intensity", "PCF", SUN, bias=-0.0015, normalBias=0.006, radius=2.5, intensity=0.7)
    add("directional_basic_default_sides", "Basic", SUN, DEFAULT)
    add("directional_pcf_default_sides", "PCF", SUN, DEFAULT, bias=0.001, radius=2.0)
    # On closed meshes the nearest surface faces the light, unless the near plane cuts them open.
    add("directional_basic_double", "Basic", SUN, DOUBLE, bias=-0.0015, camera=SMALL)
    add("directional_basic_mixed", "Basic", SUN, MIXED, bias=-0.0015)
    add("directional_pcf_mixed_normal_bias", "PCF", SUN, MIXED, normalBias=0.008)
    add("directional_pcf_frustum", "PCF", SUN, radius=3.0, bias=-0.003, camera=SMALL)
    add("directional_pcf_frustum_reversed", "PCF", SUN, is_reversed=True, radius=3.0, bias=-0.003, camera=SMALL)
    add("directional_basic_reversed", "Basic", SUN, is_reversed=True, bias=-0.0015)
    add("directional_pcf_oblong", "PCF", SUN, radius=3.0, bias=-0.003, mapSize=[160, 96])
    add("directional_pcf_overhead", "PCF", SUN, position=[0, 4, 0], target=[0, 0, 0], bias=-0.0002, radius=2.0)
    add("directional_vsm_radius_4", "VSM", SUN, radius=4.0, bias=-0.002)
    add("directional_vsm_default_sides", "VSM", SUN, DEFAULT, radius=2.5, blurSamples=5, bias=-0.001)
    add("directional_vsm_normal_bias", "VSM", SUN, radius=3.0, normalBias=0.01, blurSamples=12)
    add("directional_vsm_frustum_reversed", "VSM", SUN, is_reversed=True, radius=3.0, bias=-0.002, camera=SMALL)
    add("directional_vsm_uncast", "VSM", SUN, UNCAST, radius=6.0, blurSamples=16, intensity=0.8)
    add("spot_basic_bias", "Basic", SPOT, bias=-0.0006)
    add("spot_basic_double", "Basic", SPOT, DOUBLE, normalBias=0.006)
    add("spot_pcf_radius_4", "PCF", SPOT, bias=-0.003, radius=4.0)
    add("spot_pcf_normal_bias", "PCF", SPOT, normalBias=0.008, radius=1.5)
    add("spot_pcf_distance", "PCF", SPOT, distance=3.0, bias=-0.003, radius=2.0)
    add("spot_pcf_oblong_focus", "PCF", SPOT, mapSize=[96, 128], focus=0.8, aspect=1.2, bias=-0.002, radius=2.0)
    add("spot_pcf_reversed", "PCF", SPOT, is_reversed=True, bias=-0.002, radius=2.0)
    add("spot_vsm_radius_3", "VSM", SPOT, bias=-0.001, radius=3.0)
    # Neither sizes nor samples are powers of two, and samples lie on the borders between texels.
    add("spot_vsm_odd_sizes", "VSM", SPOT, bias=-0.002, mapSize=[90, 110], radius=1.5, blurSamples=7)
    # The engine's own range, in which depths are close to 1 and their squares cancel.
    add("spot_vsm_wide_range", "VSM", SPOT, camera={"near": 0.5, "far": 500.0}, bias=-0.0005, radius=4.0)
    # Nothing but noise.
    add("directional_vsm_radius_1", "VSM", SUN, radius=1.0)
    add("point_basic_bias", "Basic", LAMP, bias=-0.0012)
    add("point_basic_default_sides", "Basic", LAMP, DEFAULT)
    add("point_pcf_radius_4", "PCF", LAMP, bias=-0.004, radius=4.0)
    add("point_pcf_normal_bias", "PCF", LAMP, normalBias=0.012, radius=1.5)
    add("point_pcf_distance", "PCF", LAMP, distance=1.4, bias=-0.004, radius=2.0)
    add("point_basic_reversed", "Basic", LAMP, is_reversed=True, bias=-0.0012)
    add("point_pcf_reversed", "PCF", LAMP, is_reversed=True, bias=-0.003, radius=2.0)
    return cases
