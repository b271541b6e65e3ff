"""The settings of Babylon.js' goldens.

Each shows one rule at its most sensitive: all meshes cast, the ground too, and the bias is about half of what ends the
acne, so that a bias off by a tenth changes many pixels.
"""

from typing import Any

from _engine_scene import CAMERA, SIZE

MESHES = [{"mesh": "ground"}, {"mesh": "blob"}, {"mesh": "box"}, {"mesh": "torus"}]
# Babylon.js' own winding, which forcing back faces needs.
CLOCKWISE = [{**mesh, "clockwise": True} for mesh in MESHES]
TWO_SIDED = [{**mesh, "backFaceCulling": False} for mesh in MESHES]
UNCAST = [{"mesh": "ground", "casts": False}, *MESHES[1:3], {"mesh": "torus", "receives": False}]

SUN = {
    "type": "directional",
    "position": [-1.6, 3.0, 1.4],
    "direction": [1.6, -2.8, -1.4],
    "autoUpdateExtends": False,
    "shadowOrthoScale": 0.0,
    "orthoLeft": -1.9,
    "orthoRight": 1.9,
    "orthoTop": 1.7,
    "orthoBottom": -1.7,
    "shadowMinZ": 1.0,
    "shadowMaxZ": 6.5,
}
# Smaller than the scene on every side: parts of the ground lie beside it, before its near and beyond its far plane.
SMALL = {
    **SUN,
    "orthoLeft": -1.1,
    "orthoRight": 0.9,
    "orthoTop": 1.2,
    "orthoBottom": -0.7,
    "shadowMinZ": 3.0,
    "shadowMaxZ": 3.9,
}
SPOT = {
    "type": "spot",
    "position": [-1.3, 2.6, 1.2],
    "direction": [1.35, -2.6, -1.2],
    "angle": 0.9,
    "shadowMinZ": 0.8,
    "shadowMaxZ": 7.0,
}
LAMP = {"type": "point", "position": [0.1, 1.35, 0.25], "shadowMinZ": 0.15, "shadowMaxZ": 5.0}

POISSON, ESM, BLUR_ESM = "POISSONSAMPLING", "EXPONENTIALSHADOWMAP", "BLUREXPONENTIALSHADOWMAP"
KERNEL = {"useKernelBlur": True, "blurKernel": 16}
CLOSE, BLUR_CLOSE = "CLOSEEXPONENTIALSHADOWMAP", "BLURCLOSEEXPONENTIALSHADOWMAP"


def babylon_cases() -> dict[str, dict[str, Any]]:
    """The jobs of `engines.draw` by name, with names in place of meshes."""
    cases: dict[str, dict[str, Any]] = {}

    def add(name: str, filter_: str, light: dict, meshes: list = MESHES, is_float: bool = True, **more: Any) -> None:
        cases[name] = {
            "engine": "babylon",
            **SIZE,
            "meshes": meshes,
            "light": light,
            "generator": {"mapSize": 128, "usefullFloatFirst": is_float, "filter": filter_, **more},
            "camera": CAMERA,
        }

    add("directional_none_bias", "NONE", SUN, bias=0.0015)
    add("directional_none_half_float", "NONE", SUN, is_float=False, bias=0.0015)
    add("directional_none_normal_bias", "NONE", SUN, normalBias=0.015)
    add("directional_none_falloff_darkness", "NONE", SMALL, bias=0.004, darkness=0.25, frustumEdgeFalloff=0.4)
    # On closed meshes the nearest surface faces the light, unless the near plane cuts them open.
    add("directional_none_two_sided", "NONE", SMALL, TWO_SIDED, bias=0.004)
    add("directional_none_back_faces", "NONE", SUN, CLOCKWISE, bias=0.0015, forceBackFacesOnly=True)
    add("directional_none_clockwise", "NONE", SUN, CLOCKWISE, bias=0.0015)
    add("directional_none_uncast", "NONE", SUN, UNCAST, bias=0.0015)
    add("directional_poisson", POISSON, SUN, bias=0.004, blurScale=3.0)
    add("directional_poisson_darkness", POISSON, SUN, bias=0.006, darkness=0.3)
    # Beyond far receivers lie at the depth of what the map has been cleared to.
    add("directional_poisson_frustum_falloff", POISSON, SMALL, bias=0.005, frustumEdgeFalloff=0.5)
    add("directional_pcf_high", "PCF", SUN, bias=0.004)
    add("directional_pcf_medium", "PCF", SUN, bias=0.003, filteringQuality="MEDIUM")
    add("directional_pcf_low", "PCF", SUN, bias=0.003, filteringQuality="LOW")
    add("directional_pcf_normal_bias", "PCF", SUN, normalBias=0.02)
    add("directional_pcf_both_darkness", "PCF", SUN, bias=0.002, normalBias=0.01, darkness=0.35)
    add("directional_pcf_frustum_falloff", "PCF", SMALL, bias=0.006, frustumEdgeFalloff=0.3)
    overhead = {**SUN, "position": [0.0, 4.0, 0.0], "direction": [0.0, -1.0, 0.0]}
    add("directional_pcf_overhead", "PCF", overhead, bias=0.0004)
    # The engine's own fit to the casters, in x and y alone.
    fitted = {key: value for key, value in SUN.items() if not key.startswith(("ortho", "auto", "shadowOrtho"))}
    add("directional_pcf_fitted", "PCF", fitted, bias=0.003)
    square = {**SUN, "shadowFrustumSize": 3.0}
    add("directional_pcf_frustum_size", "PCF", square, bias=0.003)
    add("directional_pcss_high", "PCSS", SUN, bias=0.004, contactHardeningLightSizeUVRatio=0.06)
    add("directional_pcss_medium", "PCSS", SUN, bias=0.004, filteringQuality="MEDIUM")
    add("directional_pcss_low", "PCSS", SUN, bias=0.004, filteringQuality="LOW", darkness=0.2)
    add("directional_esm", ESM, SUN, bias=0.01)
    add("directional_esm_half_float", ESM, SUN, is_float=False, bias=0.01, depthScale=20.0)
    add("directional_blur_esm", BLUR_ESM, SUN, bias=0.02, darkness=0.2)
    add("directional_blur_esm_half_float_kernel", BLUR_ESM, SUN, is_float=False, bias=0.02, depthScale=20.0, **KERNEL)
    add("directional_close_esm", CLOSE, SUN, bias=0.002, depthScale=80.0)
    add("directional_blur_close_esm", BLUR_CLOSE, SUN, bias=0.002, blurBoxOffset=2)
    add("directional_blur_close_esm_kernel", BLUR_CLOSE, SUN, depthScale=200.0, bias=0.005, **KERNEL)
    add("directional_blur_close_esm_in_place", BLUR_CLOSE, SUN, bias=0.002, **{**KERNEL, "blurScale": 1})
    add("spot_none_bias", "NONE", SPOT, bias=0.0015)
    add("spot_pcf_bias", "PCF", SPOT, bias=0.0025)
    add("spot_pcf_normal_bias", "PCF", SPOT, normalBias=0.02)
    add("spot_poisson", POISSON, SPOT, bias=0.004)
    add("spot_pcss", "PCSS", SPOT, bias=0.002, contactHardeningLightSizeUVRatio=0.06)
    add("spot_close_esm", CLOSE, SPOT, bias=0.002)
    narrow = {"useKernelBlur": True, "blurKernel": 8}
    add("spot_blur_close_esm_half_float_kernel", BLUR_CLOSE, SPOT, is_float=False, bias=0.004, **narrow)
    add("point_none_bias", "NONE", LAMP, bias=0.003)
    add("point_poisson", POISSON, LAMP, bias=0.006)
    add("point_pcf_is_poisson", "PCF", LAMP, bias=0.006)
    add("point_none_normal_bias", "NONE", LAMP, normalBias=0.03)
    add("point_esm", ESM, LAMP, bias=0.01, depthScale=30.0)
    add("point_close_esm", CLOSE, LAMP, bias=0.002)
    return cases
