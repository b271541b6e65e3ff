"""Whether a part of a scene contributes to an image's shadows."""

import numpy as np
from jaxtyping import Bool

from .._types import HostArray
from ..geometry import Scene
from ._embree import EmbreeTracer
from ._visibility import BATCH, Centre, Job, sampling_of

# Shadow rays per pixel to a light that has a size.
_SAMPLES = 16


def hides_light(scene: Scene, faces: Bool[HostArray, " f"]) -> bool:
    """Whether any of `faces` lies between a light and a surface seen through a pixel's centre.

    Faces count even if others block the same light. For a light with a size, 16 points are tried per pixel.

    **Arguments:**

    - `scene`: concrete, not traced by JAX, with one light or several.
    - `faces`: (f,), true for the faces of the scene's mesh to test.
    """
    for index, light in enumerate(scene.lights):
        sampling = sampling_of(light, _SAMPLES, "sobol", 0)
        job = Job(EmbreeTracer, scene.lit_by(index), sampling)
        part = EmbreeTracer(job.triangles.only(faces))
        step = max(1, BATCH // sampling.samples)
        for first in range(0, job.size, step):
            count = min(step, job.size - first)
            seen, hits = job.hits(first, count)
            _, hidden = job.shadowed(hits, sampling.points(first, count, seen), part)
            if hidden.any():
                return True
    return False


def hidden_pixels(scene: Scene, faces: Bool[HostArray, " f"]) -> Bool[HostArray, "h w"]:
    """Pixels whose surface is turned to the centre of the scene's only light, and from which any of `faces` hides it.

    **Arguments:**

    - `scene`: concrete, not traced by JAX, with one light.
    - `faces`: (f,), true for the faces of the scene's mesh to test.

    **Returns:** (h, w), row 0 the bottom row.
    """
    job = Job(EmbreeTracer, scene, None)
    hidden = np.zeros(job.size, bool)
    if faces.any():
        part = EmbreeTracer(job.triangles.only(faces))
        for first in range(0, job.size, BATCH):
            count = min(BATCH, job.size - first)
            seen, hits = job.hits(first, count)
            hidden[first + seen] = job.shadowed(hits, Centre().points(first, count, seen), part)[1][:, 0]
    return hidden.reshape(job.rays.height, job.rays.width)
