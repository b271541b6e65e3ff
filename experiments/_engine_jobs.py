"""Scenes as jobs for the real engines."""

from typing import Any

import _common as common
import numpy as np
from engines.engines import vertex_normals

from diffshadow.shadow import AbstractEngineShadows, BabylonJs, EngineLight, GodotCompatibility, PlayCanvas, ThreeJs

Engine = AbstractEngineShadows
NEAR = 1 / 255
"""The most that visibilities may differ by and count as equal."""


def engine_job(case: common.Case, technique: Engine, drawn: list[Engine]) -> dict[str, Any]:
    """A scene as `engines.draw` takes it, with a drawing for each of `drawn`."""
    scene, camera = case.scene, case.scene.camera.view()
    makers = {ThreeJs: _three_js, BabylonJs: _babylon_js, PlayCanvas: _playcanvas, GodotCompatibility: _godot}
    own = makers[type(technique)]
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


def _playcanvas(light: EngineLight, technique: PlayCanvas) -> tuple[dict[str, Any], dict[str, Any]]:
    """What is PlayCanvas' own of a job, and of its meshes."""
    given: dict[str, Any] = {"type": "omni" if light.type == "point" else light.type}
    if light.type == "directional":
        given |= {"shadowDistance": technique.shadow_distance, "numCascades": technique.num_cascades}
        given |= {"cascadeDistribution": technique.cascade_distribution, "direction": light.direction}
    else:
        given |= {"position": light.position, "range": light.far}
    if light.angle is not None:
        angle = float(np.degrees(light.angle))
        given |= {"direction": light.direction, "outerConeAngle": angle, "innerConeAngle": angle}
    given |= {"shadowType": technique.shadow_type, "shadowResolution": technique.resolution[0], **_shadow(technique)}
    return {"engine": "playcanvas", "light": given}, {"side": technique.side}


def _godot(light: EngineLight, technique: GodotCompatibility) -> tuple[dict[str, Any], dict[str, Any]]:
    """What is Godot's own of a job, and of its meshes."""
    given: dict[str, Any] = {"type": "omni" if light.type == "point" else light.type}
    if light.direction is not None:
        given["direction"] = light.direction
    if light.type == "directional":
        names = ("max_distance", "pancake_size", "fade_start")
        given |= {f"directional_shadow_{name}": getattr(technique, f"directional_shadow_{name}") for name in names}
        given["directional_shadow_mode"] = MODES.index(technique.directional_shadow_mode)
    else:
        given |= {"position": light.position, "spot_range" if light.type == "spot" else "omni_range": light.far}
    if light.angle is not None:
        given["spot_angle"] = float(np.degrees(light.angle))
    # A cube's faces are half as wide as the light's part of the atlas.
    size = technique.resolution[0] * (2 if light.type == "point" else 1)
    quality = QUALITIES.index(technique.soft_filter_quality)
    job = {"engine": "godot", "size": size, "quality": quality, "light": {**given, **_shadow(technique)}}
    return job, {"side": technique.side}


QUALITIES = ("HARD", "SOFT_VERY_LOW", "SOFT_LOW", "SOFT_MEDIUM", "SOFT_HIGH", "SOFT_ULTRA")
MODES = ("SHADOW_ORTHOGONAL", "SHADOW_PARALLEL_2_SPLITS", "SHADOW_PARALLEL_4_SPLITS")


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
    if isinstance(technique, PlayCanvas):
        return {
            "shadowBias": float(technique.shadow_bias),
            "normalOffsetBias": float(technique.normal_offset_bias),
            "shadowIntensity": float(technique.shadow_intensity),
        }
    if isinstance(technique, GodotCompatibility):
        names = ("shadow_bias", "shadow_normal_bias")
        return {name: float(getattr(technique, name)) for name in names}
    assert isinstance(technique, BabylonJs)
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
