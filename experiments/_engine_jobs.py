"""Scenes as jobs for the real engines."""

from typing import Any

import _common as common
import numpy as np
from engines.engines import vertex_normals

from diffshadow.shadow import BabylonJs, EngineLight, ThreeJs

Engine = ThreeJs | BabylonJs
NEAR = 1 / 255
"""The most that visibilities may differ by and count as equal."""


def engine_job(case: common.Case, technique: Engine, drawn: list[Engine]) -> dict[str, Any]:
    """A scene as `engines.draw` takes it, with a drawing for each of `drawn`."""
    scene, camera = case.scene, case.scene.camera.view()
    own = _three_js if isinstance(technique, ThreeJs) else _babylon_js
    rows, columns = case.surface.mask.shape
    settings, materials = own(EngineLight.of(scene.light, technique.resolution), technique)
    meshes = []
    for i, mesh in enumerate(scene.meshes):
        vertices, normals, faces = vertex_normals(mesh.vertices, mesh.faces, mesh.corner_normals)
        casts = scene.casts is None or scene.casts[i]
        material = {key: value[i] if isinstance(value, tuple) else value for key, value in materials.items()}
        meshes.append({"vertices": vertices, "normals": normals, "faces": faces, "casts": casts, **material})
    return {
        "width": columns,
        "height": rows,
        "meshes": meshes,
        "camera": {"view": np.asarray(camera.world_to_eye), "projection": np.asarray(camera.eye_to_clip)},
        "outputs": ["mesh", "position", "normal"],
        "grid": [_shadow(each) for each in drawn],
        **settings,
    }


def _three_js(light: EngineLight, technique: ThreeJs) -> tuple[dict[str, Any], dict[str, Any]]:
    """What is three.js' own of a job, and of its meshes."""
    height, width = technique.resolution
    given = {
        "type": light.type,
        "position": light.position,
        "mapSize": [width, height],
        "camera": {**(light.window or {}), "near": light.near, "far": light.far},
        **({} if light.target is None else {"target": light.target}),
        **({} if light.angle is None else {"angle": light.angle, "aspect": light.aspect}),
        **_shadow(technique),
    }
    settings = {
        "engine": "three",
        "light": given,
        "shadowType": technique.shadow_type.removesuffix("ShadowMap"),
        "reversedDepthBuffer": technique.reversed_depth,
    }
    return settings, {"side": technique.side, "shadowSide": technique.shadow_side}


def _babylon_js(light: EngineLight, technique: BabylonJs) -> tuple[dict[str, Any], dict[str, Any]]:
    """What is Babylon.js' own of a job, and of its meshes."""
    given: dict[str, Any] = {"type": light.type, "position": light.position}
    given |= {"shadowMinZ": light.near, "shadowMaxZ": light.far}
    if light.target is not None:
        given["direction"] = light.direction
    if light.angle is not None:
        given["angle"] = 2 * light.angle
    if light.window is not None:
        # The engine's camera is left-handed: its x runs the other way.
        left, right, top, bottom = (light.window[key] for key in ("left", "right", "top", "bottom"))
        given |= {"orthoLeft": -right, "orthoRight": -left, "orthoTop": top, "orthoBottom": bottom}
        given |= {"autoUpdateExtends": False, "shadowOrthoScale": 0.0}
    generator = {
        "mapSize": technique.resolution[0],
        "usefullFloatFirst": technique.float_maps,
        "filter": technique.filter,
        "filteringQuality": technique.quality,
        "forceBackFacesOnly": technique.force_back_faces_only,
        **_shadow(technique),
    }
    return {"engine": "babylon", "light": given, "generator": generator}, {
        "backFaceCulling": technique.back_face_culling
    }


def _shadow(technique: Engine) -> dict[str, Any]:
    """The shadow's own settings by the engine's names."""
    if isinstance(technique, ThreeJs):
        return {
            "bias": float(technique.bias),
            "normalBias": float(technique.normal_bias),
            "radius": float(technique.radius),
            "intensity": float(technique.intensity),
            "blurSamples": technique.blur_samples,
        }
    return {
        "bias": float(technique.bias),
        "normalBias": float(technique.normal_bias),
        "darkness": float(technique.darkness),
        "blurScale": float(technique.blur_scale),
        "blurKernel": technique.blur_kernel,
        "blurBoxOffset": technique.blur_box_offset,
        "useKernelBlur": technique.use_kernel_blur,
        "depthScale": float(technique.depth_scale),
        "frustumEdgeFalloff": float(technique.frustum_edge_falloff),
        "contactHardeningLightSizeUVRatio": float(technique.contact_hardening_light_size_uv_ratio),
    }
