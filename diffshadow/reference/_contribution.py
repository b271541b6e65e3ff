"""Whether a light, or a part of a scene, contributes to an image's shadows."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Bool

from .._types import HostArray
from ..geometry import Scene
from ..settings.reference import Blockers
from ..settings.reference import TracedReference as Settings
from ._embree import EmbreeTracer
from ._visibility import BATCH, Centre, Job, blocking_faces, sampling_of

# Shadow rays per pixel to a light that has a size.
_SAMPLES = 16


def hides_light(scene: Scene, faces: Bool[HostArray, " f"], blockers: Blockers = Settings.blockers) -> bool:
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
    for index in range(len(scene.lights)):
        job = _job(scene.lit_by(index), blockers)
        part = EmbreeTracer(job.triangles.only(faces))
        for _, hits, samples in _batches(job):
            _, hidden = job.shadowed(hits, samples, part)
            if hidden.any():
                return True
    return False


def is_lit(scene: Scene, pixels: Bool[HostArray, "h w"], blockers: Blockers = Settings.blockers) -> bool:
    """Whether a light reaches a surface seen through the centre of one of `pixels`; arguments are as for `hides_light`.

    For a light with a size, 16 points are tried per pixel. It takes little time if a light reaches one.

    **Arguments:**

    - `pixels`: (h, w), true for the pixels to test, row 0 at the bottom.
    """
    tested = pixels.reshape(-1)
    for index in range(len(scene.lights)):
        job = _job(scene.lit_by(index), blockers)
        for pixel, hits, samples in _batches(job):
            above, hidden = job.shadowed(hits, samples, job.occluders)
            if (above & ~hidden)[tested[pixel]].any():
                return True
    return False


def _job(scene: Scene, blockers: Blockers) -> Job:
    # SciPy's sequences would take a second to load.
    return Job(EmbreeTracer, scene, sampling_of(scene.light, _SAMPLES, "stratified", 0), blockers)


def _batches(job: Job) -> Iterator[tuple[Any, Any, Any]]:
    """For each batch of pixels, the indices of pixels whose ray hits a surface, the hits, and points of the light."""
    assert job.sampling is not None
    step = max(1, BATCH // job.sampling.samples)
    for first in range(0, job.size, step):
        count = min(step, job.size - first)
        seen, hits = job.hits(first, count)
        if len(seen):
            yield first + seen, hits, job.sampling.points(first, count, seen)


def hidden_pixels(scene: Scene, faces: Bool[HostArray, " f"]) -> Bool[HostArray, "h w"]:
    """Pixels whose surface is turned to the centre of the scene's only light, where any of `faces` hides this centre.

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
