"""Remarks on the layouts of maps: missing memory or levels, and unstable cascades."""

from collections.abc import Iterator, Sequence
from typing import Any

from ... import shadow
from ...config import Config
from ...settings.techniques import Cascades


def layout_remarks(
    technique: shadow.AbstractTechnique | shadow.FittableTechnique, keys: Sequence[str], states: Sequence[Any]
) -> Iterator[str]:
    """A sentence for each light and each remark of the layout of `technique`, if it has one.

    **Arguments:** `keys`, `states`: the key of each light, and the technique's state for it.
    """
    if not isinstance(technique, shadow.ShadowMapping):
        return
    for key, state in zip(keys, states, strict=True):
        for remark in technique.layout.remarks(state.light):
            yield f"{key} {remark}"


def frames_remarks(frames: Sequence[Config]) -> Iterator[str]:
    """Warns if stabilized cascades change between `frames` although they could be stable."""
    first = frames[0]
    technique, camera = first.technique, first.scene.camera
    if not (isinstance(technique, Cascades) and technique.stabilize) or technique.depths == "surface":
        return
    if all(frame.scene.camera == camera and frame.scene.meshes == first.scene.meshes for frame in frames):
        return
    ends = technique.distances is not None or technique.shadow_distance is not None
    found = [name for name in ("near", "far") if getattr(camera, name) is None and not (name == "far" and ends)]
    if found:
        keys = " and ".join(f"scene.camera.{name}" for name in found)
        yield (
            f"cascades are not stable from frame to frame, although technique.stabilize is true: {keys} "
            f"{'is' if len(found) == 1 else 'are'} found again for each frame, so cascades change size; set "
            f"{'it' if len(found) == 1 else 'them'} for stable cascades"
        )
