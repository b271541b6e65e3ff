"""The settings of Godot's goldens, drawn by its Compatibility renderer.

Each shows one rule at its most sensitive: all meshes cast, the ground too, and the normal bias is about half of what
ends the acne, so that one that is off by a tenth changes many pixels.
"""

from typing import Any

from _engine_scene import CAMERA, SIZE

MESHES = [{"mesh": "ground"}, {"mesh": "blob"}, {"mesh": "box"}, {"mesh": "torus"}]
UNCAST = [{"mesh": "ground", "casts": False}, {"mesh": "blob"}, {"mesh": "box", "side": "double"}]

ORTHOGONAL, FOUR = 0, 2
SUN = {
    "type": "directional",
    "direction": [1.6, -2.8, -1.4],
    "directional_shadow_max_distance": 8.0,
    "directional_shadow_mode": ORTHOGONAL,
}
SPOT = {
    "type": "spot",
    "position": [-1.3, 2.6, 1.2],
    "direction": [1.35, -2.6, -1.2],
    "spot_range": 7.0,
    "spot_angle": 26.0,
}
LAMP = {"type": "omni", "position": [0.1, 1.35, 0.25], "omni_range": 5.0}
# Constants of `RenderingServer.SHADOW_QUALITY_`.
HARD, SOFT_LOW, SOFT_HIGH = 0, 2, 4


def godot_cases() -> dict[str, dict[str, Any]]:
    """The jobs of `engines.draw` by name, with names in place of meshes."""
    cases: dict[str, dict[str, Any]] = {}

    def add(name: str, light: dict, quality: int, meshes: list = MESHES, size: int = 128, **more: Any) -> None:
        cases[name] = {
            "engine": "godot",
            **SIZE,
            "meshes": meshes,
            "light": {**light, **more},
            "size": size,
            "quality": quality,
            "camera": CAMERA,
        }

    add("directional_soft_default", SUN, SOFT_LOW, shadow_bias=0.1, shadow_normal_bias=2.0)
    add("directional_hard_both", SUN, HARD, shadow_bias=0.5, shadow_normal_bias=0.5)
    add("directional_high_normal", SUN, SOFT_HIGH, shadow_bias=0.1, shadow_normal_bias=1.3)
    # Shadows begin to fade out before the farthest ground.
    fading = {**SUN, "directional_shadow_max_distance": 4.2, "directional_shadow_pancake_size": 5.0}
    add("directional_soft_fading", fading, SOFT_LOW, UNCAST, shadow_bias=1.0, shadow_normal_bias=0.6)
    splits = {**SUN, "directional_shadow_mode": FOUR}
    add("directional_four_splits", splits, SOFT_LOW, size=256, shadow_bias=0.1, shadow_normal_bias=0.5)
    add("spot_soft_both", SPOT, SOFT_LOW, shadow_bias=0.03, shadow_normal_bias=1.0)
    add("spot_hard_bias", SPOT, HARD, shadow_bias=0.2, shadow_normal_bias=0.0)
    add("omni_both", LAMP, HARD, shadow_bias=0.02, shadow_normal_bias=0.3)
    return cases
