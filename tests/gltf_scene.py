"""A small scene as glTF stores it."""

import base64
import math

import numpy as np

TRIANGLE = [0, 0, 0, 1, 0, 0, 0, 1, 0]


def gltf():
    """A triangle below a turned node, with a camera and a light of each kind."""
    data = np.concatenate([np.array(TRIANGLE, "<f4"), np.tile(np.array([0, 0, 1], "<f4"), 3)]).tobytes()
    turn = [math.sin(math.pi / 4), 0, 0, math.cos(math.pi / 4)]  # -z becomes +y
    accessor = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
    kinds = [{"type": "directional"}, {"type": "point"}, {"type": "spot", "spot": {"outerConeAngle": 0.5}}]
    lit = [
        {
            "name": f"light {i}",
            "rotation": turn,
            "translation": [0, 0, i],
            "extensions": {"KHR_lights_punctual": {"light": i}},
        }
        for i in range(3)
    ]
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(data), "uri": "data:;base64," + base64.b64encode(data).decode()}],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        "accessors": [accessor, {**accessor, "byteOffset": 36}],
        "materials": [{"doubleSided": True, "alphaMode": "MASK"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "material": 0}]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}],
        "nodes": [
            {"name": "triangle", "mesh": 0, "rotation": turn},
            {"camera": 0, "rotation": turn, "scale": [2, 2, 2]},
            *lit,
        ],
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {"KHR_lights_punctual": {"lights": kinds}},
    }
