"""The settings of Bevy's goldens.

Each shows one rule at its most sensitive: all meshes cast both sides, the ground too, and the bias is about half of
what ends the acne, so that one that is off by a tenth changes many pixels.
"""

from typing import Any

from _engine_scene import CAMERA, SIZE

MESHES = [{"mesh": "ground"}, {"mesh": "blob"}, {"mesh": "box"}, {"mesh": "torus"}]
SUN = {
    "type": "directional",
    "direction": [1.6, -2.8, -1.4],
    "num_cascades": 1,
    "minimum_distance": 0.5,
    "maximum_distance": 8.0,
    "first_cascade_far_bound": 3.3,
    "overlap_proportion": 0.2,
}
SPOT = {
    "type": "spot",
    "position": [-1.3, 2.6, 1.2],
    "direction": [1.35, -2.6, -1.2],
    "range": 7.0,
    "outer_angle": 0.45,
    "shadow_map_near_z": 0.1,
}


def bevy_cases() -> dict[str, dict[str, Any]]:
    """The jobs of `bevy_job.draw` by name, with names in place of meshes."""
    cases: dict[str, dict[str, Any]] = {}

    def add(name: str, light: dict, depth: float, normal: float, filter_: str = "Gaussian", **more: Any) -> None:
        biases = {"shadow_depth_bias": depth, "shadow_normal_bias": normal}
        job = {"engine": "bevy", **SIZE, "meshes": MESHES, "camera": CAMERA, "mapSize": 128, "filter": filter_}
        cases[name] = {**job, "light": {**light, **biases, **more}}

    add("directional_default", SUN, 0.02, 1.8)
    add("directional_low", SUN, 0.01, 0.3)
    add("directional_hardware", SUN, 0.02, 0.4, "Hardware2x2")
    add("directional_two_cascades", SUN, 0.02, 0.5, num_cascades=2)
    add("spot_low", SPOT, 0.005, 0.3)
    add("spot_default", SPOT, 0.02, 1.8)
    return cases
