"""The settings of PlayCanvas' goldens.

Each shows one rule at its most sensitive: all meshes cast, the ground too, and a setting that is off by a tenth changes
many pixels.
"""

from typing import Any

from _engine_scene import CAMERA, SIZE

MESHES = [{"mesh": "ground"}, {"mesh": "blob"}, {"mesh": "box"}, {"mesh": "torus"}]
UNCAST = [{"mesh": "ground", "casts": False}, {"mesh": "blob", "side": "back"}, {"mesh": "box", "side": "double"}]

SUN = {"type": "directional", "direction": [1.6, -2.8, -1.4], "shadowDistance": 8.0}
SPOT = {
    "type": "spot",
    "position": [-1.3, 2.6, 1.2],
    "direction": [1.35, -2.6, -1.2],
    "range": 7.0,
    "innerConeAngle": 24.0,
    "outerConeAngle": 26.0,
}
LAMP = {"type": "omni", "position": [0.1, 1.35, 0.25], "range": 5.0}


def playcanvas_cases() -> dict[str, dict[str, Any]]:
    """The jobs of `engines.draw` by name, with names in place of meshes."""
    cases: dict[str, dict[str, Any]] = {}

    def add(name: str, light: dict, shadow_type: str, meshes: list = MESHES, size: int = 128, **more: Any) -> None:
        cases[name] = {
            "engine": "playcanvas",
            **SIZE,
            "meshes": meshes,
            "light": {**light, "shadowType": shadow_type, "shadowResolution": size, **more},
            "camera": CAMERA,
        }

    add("directional_pcf3_default", SUN, "PCF3_32F")
    add("directional_pcf1_bias", SUN, "PCF1_32F", shadowBias=0.02)
    add("directional_pcf5_both", SUN, "PCF5_32F", shadowBias=0.1, normalOffsetBias=0.02)
    add("directional_pcf3_normal", SUN, "PCF3_32F", shadowBias=0.0, normalOffsetBias=0.012)
    # Parts of the ground lie beyond the shadow distance; some meshes do not cast their front faces.
    add("directional_pcf3_short", {**SUN, "shadowDistance": 3.2}, "PCF3_32F", UNCAST, shadowIntensity=0.6)
    add("directional_pcf3_cascades", SUN, "PCF3_32F", shadowBias=0.02, size=256, numCascades=3)
    add("spot_pcf1_bias", SPOT, "PCF1_32F", shadowBias=0.02)
    add("spot_pcf3_both", SPOT, "PCF3_32F", shadowBias=0.08, normalOffsetBias=0.01)
    add("omni_pcf1_normal", LAMP, "PCF1_32F", shadowBias=0.0, normalOffsetBias=0.03)
    add("omni_pcf3_bias", LAMP, "PCF3_32F", shadowBias=0.2)
    return cases
