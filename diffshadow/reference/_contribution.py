"""Whether a part of a scene matters to a picture's shadows."""

from jaxtyping import Bool

from .._types import HostArray
from ..geometry import Scene
from ._embree import EmbreeTracer
from ._visibility import BATCH, Job, sampling_of

# Shadow rays of each pixel towards a light that has a size.
_SAMPLES = 16


def hides_light(scene: Scene, faces: Bool[HostArray, "f"]) -> bool:
    """Whether some `faces` lie between a light and a surface that a pixel's centre sees.

    It does not matter whether other faces hide the same light. Of a light with a size, 16 points are tried from each
    pixel.

    **Arguments:**

    - `scene`: concrete, not traced by JAX, with one light or several.
    - `faces`: (f,), which faces of the scene's mesh.
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
