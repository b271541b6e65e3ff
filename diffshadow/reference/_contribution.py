"""Whether a part of a scene contributes to an image's shadows."""

from jaxtyping import Bool

from .._types import HostArray
from ..geometry import Scene
from ._embree import EmbreeTracer
from ._visibility import BATCH, Blockers, Job, blocking_faces, sampling_of

# Shadow rays per pixel to a light that has a size.
_SAMPLES = 16


def hides_light(scene: Scene, faces: Bool[HostArray, " f"], blockers: Blockers = "casters") -> bool:
    """Whether any of `faces` blocks a ray between a light and a surface seen through a pixel's centre.

    Faces count even if others block the same light. For a light with a size, 16 points are tried per pixel.

    **Arguments:**

    - `scene`: concrete, not traced by JAX, with one light or several.
    - `faces`: (f,), true for the faces of the scene's mesh to test.
    - `blockers`: as for `trace_visibility`.
    """
    faces = faces & blocking_faces(scene, blockers)
    if not faces.any():
        return False
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
