"""Ray-traced visibility of a light: camera rays to the surface, shadow rays to the light."""

import dataclasses
import os
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int

from .._checks import check_outside_trace
from .._progress import showing
from .._types import HostArray
from ..geometry import AbstractLight, Mesh, Scene
from ..settings.reference import Blockers, Sampler
from ..settings.reference import TracedReference as Settings
from ._embree import EmbreeTracer
from ._lamp import Lamp
from ._rays import CameraRays, Hits, Rays, ShadowRays, Triangles, hits_on_planes
from ._reference import Reference
from ._sampling import LightSampler, check_sampling
from ._tracer import AbstractTracer

# Rays per batch: few enough to stay in cache, and to keep memory at tens of megabytes per thread.
BATCH = 1 << 16
# Shadow rays stop this fraction of their length short of a light at a finite distance, so that a light on a surface is
# not occluded by it.
_SHORT_OF_LIGHT = 2.0**-20


def trace_visibility(
    scene: Scene,
    samples: int = Settings.samples,
    sampler: Sampler = Settings.sampler,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    supersampling: int = Settings.supersampling,
    blockers: Blockers = Settings.blockers,
) -> Reference:
    """Traces how much of the scene's light is visible from each pixel of its camera.

    A ray through each pixel's centre finds the surface between the camera's near and far distances. Shadow rays from
    there to points of the light find which of these are occluded. Every surface is two-sided, but receives light only
    on the side that faces the camera: parts of the light below that side's horizon count as occluded. As in engines, a
    mesh that does not cast is visible but blocks no shadow ray. So a lamp may be inside its own bulb. All rays pass
    through the holes of an alpha test. A light's cone, near and far are ignored, since they are settings of a shadow
    map.

    **Arguments:**

    - `scene`: concrete, not traced by JAX, with one light; for several lights, trace `scene.lit_by(index)` for each.
    - `samples`: shadow rays per pixel, 1 to 65536. A light without size gets a single ray, to its centre.
    - `sampler`: `"sobol"` or `"stratified"`.
    - `seed`: seed of the sample points, an integer of 0 or more. The same arguments give the same image, bit for bit.
    - `progress`: called with the fraction of pixels done, in (0, 1], in the calling thread. If left out,
        `diffshadow.setup` decides whether a line shows the progress.
    - `supersampling`: camera rays along each side of a pixel, 1 to 8; 4 gives a 4 x 4 grid. Visibility is then the mean
      over the camera rays that hit a surface, which antialiases outlines. The shadow rays are divided among the camera
      rays, with at least one each. `position`, `normal` and `face` still belong to pixel centres.
    - `blockers`: what blocks shadow rays: `"casters"`, or `"all"` meshes, including meshes that do not cast.

    **Returns:** a `Reference`.

    **Raises** `ValueError` under a trace, if the scene has several lights, the camera sees no surface, `samples`,
    `seed` or `supersampling` is out of range, or `sampler` or `blockers` is unknown.

    !!! Example

        ```python
        truth = reference.trace_visibility(scene, samples=4)
        truth.visibility.shape, truth.mask.shape  # ((32, 32), (32, 32))
        ```
    """
    with showing("tracing", unless=progress is not None) as update:
        if update is not None:
            progress = lambda done: update("", done)
        return trace_with(EmbreeTracer, scene, samples, sampler, seed, progress, supersampling, blockers)


def reference_from_image(visibility: Any, scene: Scene) -> Reference:
    """A `Reference` with a given visibility image; its surfaces are found by camera rays.

    **Arguments:**

    - `visibility`: (h, w), values in [0, 1], row 0 at the bottom; h and w are the camera's resolution.

    **Returns:** a `Reference` with `samples` 0 and `standard_error` 0.

    **Raises** `ValueError` if the image's shape is not the camera's, a value lies outside [0, 1], or the camera sees no
    surface.
    """
    check_known("reference_from_image", (visibility, scene))
    image = np.asarray(visibility)
    if image.shape != tuple(scene.camera.resolution):
        raise ValueError(
            f"the visibility image has shape {image.shape}, but the camera's resolution is "
            f"{tuple(scene.camera.resolution)} (height, width); expected the same: resize the image, set the camera's "
            "resolution, or pick one channel of a colour image"
        )
    image = image.astype(np.float32)
    if not (np.isfinite(image).all() and image.min() >= 0 and image.max() <= 1):
        raise ValueError(
            f"the visibility image holds values from {image.min()} to {image.max()}; expected finite values from "
            "0 (shadowed) to 1 (lit): divide 8-bit images by 255"
        )
    job = Job(EmbreeTracer, scene, None)
    job.run(None)
    return job.reference(samples=0, visibility=np.where(job.face >= 0, image.reshape(-1), np.float32(1)))


def check_known(name: str, given: Any) -> None:
    """**Raises** `ValueError` if a scene or an image is traced; `name` is the function that it was given to."""
    remedy = "trace outside, and pass the reference in, since rays are traced on the host and have no gradient"
    check_outside_trace(name, "a scene and images of known numbers", remedy, given)


def trace_with(
    make_tracer: Callable[[Triangles], AbstractTracer],
    scene: Scene,
    samples: int,
    sampler: str,
    seed: int,
    progress: Callable[[float], None] | None,
    supersampling: int,
    blockers: Blockers,
) -> Reference:
    """`trace_visibility` with the tracer that `make_tracer` makes from the scene's triangles."""
    check_known("trace_visibility", scene)
    check_sampling(samples, sampler, supersampling, blockers)
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed is {seed!r}; expected an integer of 0 or more")
    sampling = sampling_of(scene.light, max(1, samples // supersampling**2), sampler, int(seed))

    def traced(scene: Scene) -> Reference:
        job = Job(make_tracer, scene, sampling, blockers)
        job.run(progress)
        return job.reference(samples=sampling.samples, visibility=job.visibility)

    if supersampling == 1:
        return traced(scene)
    finer = tuple(supersampling * side for side in scene.camera.resolution)
    fine = traced(dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, resolution=finer)))
    centres = Job(make_tracer, scene, None)
    centres.run(None)
    return _averaged(fine, centres.reference(fine.samples * supersampling**2, centres.visibility), supersampling)


def _averaged(fine: Reference, centres: Reference, supersampling: int) -> Reference:
    """`centres` with the visibility of `fine`, which has `supersampling` pixels along each side of a pixel."""
    height, width = centres.mask.shape
    blocks = lambda image: image.reshape(height, supersampling, width, supersampling)
    total = lambda image: blocks(np.where(fine.mask, image, 0)).sum(axis=(1, 3), dtype=np.float64)
    count = total(1.0)
    mask, divisor = centres.mask & (count > 0), np.maximum(count, 1)
    return dataclasses.replace(
        centres,
        mask=mask,
        visibility=np.where(mask, total(fine.visibility) / divisor, 1).astype(np.float32),
        standard_error=np.where(mask, np.sqrt(total(fine.standard_error**2)) / divisor, 0).astype(np.float32),
    )


class Centre:
    """The one sample point of a light without size: its centre."""

    samples = 1

    def points(self, first: int, count: int, chosen: Int[HostArray, " n"]) -> Float32[HostArray, "n 1 2"]:
        return np.zeros((len(chosen), 1, 2), dtype=np.float32)


Sampling = LightSampler | Centre
"""Chooses the points of a light that shadow rays are aimed at."""


def sampling_of(light: AbstractLight, samples: int, sampler: str, seed: int) -> Sampling:
    """`samples` points per pixel, or only the centre for a light without size."""
    return LightSampler(light.domain, samples, sampler, seed) if light.has_size else Centre()


class _Traced(NamedTuple):
    """The triangles of a scene, a tracer of all of them, and one of those that block shadow rays."""

    triangles: Triangles
    tracer: AbstractTracer
    occluders: AbstractTracer


# What was made for the last meshes, since the views of a fit share them. It is dropped with the first of these.
_last: dict[tuple[Any, ...], tuple[list[weakref.ref[Mesh]], _Traced]] = {}


def _traced(
    make_tracer: Callable[[Triangles], AbstractTracer], scene: Scene, blocking: Bool[HostArray, " f"]
) -> _Traced:
    """The tracers of a scene. `blocking` says which faces block shadow rays."""
    key = make_tracer, blocking.tobytes(), len(scene.meshes)
    refs, kept = _last.get(key, ([], None))
    if kept is not None and all(ref() is mesh for ref, mesh in zip(refs, scene.meshes, strict=True)):
        return kept
    triangles = Triangles(scene.mesh)
    tracer = make_tracer(triangles)
    kept = _Traced(triangles, tracer, tracer if blocking.all() else make_tracer(triangles.only(blocking)))
    _last.clear()
    _last[key] = [weakref.ref(mesh, lambda _: _last.clear()) for mesh in scene.meshes], kept
    return kept


class Job:
    """One image being traced. Images are flat arrays of pixels. If `sampling` is `None`, no shadow rays are traced.

    - `tracer`: tracer of all triangles, which the camera sees; `occluders`: tracer of the triangles that block shadow
        rays.
    """

    def __init__(
        self,
        make_tracer: Callable[[Triangles], AbstractTracer],
        scene: Scene,
        sampling: Sampling | None,
        blockers: Blockers = Settings.blockers,
    ):
        self.scene, self.sampling = scene, sampling
        blocking = blocking_faces(scene, "all" if sampling is None else blockers)
        self.triangles, self.tracer, self.occluders = _traced(make_tracer, scene, blocking)
        self.rays = CameraRays(scene.camera, self.triangles)
        self.lamp = Lamp(scene.light, self.triangles)
        self.reach = np.inf if self.lamp.is_directional else 1 - _SHORT_OF_LIGHT
        self.size = self.rays.height * self.rays.width
        self.position, self.normal = (np.zeros((self.size, 3), dtype=np.float32) for _ in range(2))
        self.face = np.full(self.size, -1, dtype=np.int32)
        self.visibility = np.ones(self.size, dtype=np.float32)
        self.standard_error = np.zeros(self.size, dtype=np.float32)

    def run(self, progress: Callable[[float], None] | None) -> None:
        """Traces all pixels in batches on all cores; the tracer and NumPy release the interpreter lock."""
        step = max(1, BATCH // (self.sampling.samples if self.sampling else 1))
        starts = range(0, self.size, step)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            batches = [pool.submit(self._trace, first, min(step, self.size - first)) for first in starts]
            try:
                for done, batch in enumerate(as_completed(batches), start=1):
                    batch.result()
                    if progress is not None:
                        progress(done / len(batches))
            finally:
                # After an error or an interrupt, do not wait for batches that have not started.
                pool.shutdown(wait=True, cancel_futures=True)

    def reference(self, samples: int, visibility: Float32[HostArray, " n"]) -> Reference:
        """The finished image."""
        mask = self.face >= 0
        if not mask.any():
            raise ValueError(_nothing_seen(self.scene, self.rays, self.triangles))
        shape = (self.rays.height, self.rays.width)
        return Reference(
            visibility=visibility.reshape(shape),
            mask=mask.reshape(shape),
            position=self.position.reshape(*shape, 3),
            normal=self.normal.reshape(*shape, 3),
            face=self.face.reshape(shape),
            samples=samples,
            standard_error=self.standard_error.reshape(shape),
        )

    def hits(self, first: int, count: int) -> tuple[Int[HostArray, " n"], Hits]:
        """Which of the `count` pixels from `first` on hit a surface, as indices from `first`, and the hits."""
        rays = self.rays.pixels(first, count)
        face = self.tracer.closest(rays)
        seen = np.flatnonzero(face >= 0)
        return seen, hits_on_planes(Rays(*(x[seen] for x in rays)), face[seen], self.triangles)

    def _trace(self, first: int, count: int) -> None:
        """Finds the surfaces of a batch of pixels and, unless `sampling` is `None`, their visibility."""
        seen, hits = self.hits(first, count)
        if not len(seen):
            return
        pixel = first + seen
        self.face[pixel] = hits.face
        self.position[pixel] = self.triangles.to_world(hits.position)
        self.normal[pixel] = hits.normal
        if self.sampling is None:
            return
        above, hidden = self.shadowed(hits, self.sampling.points(first, count, seen), self.occluders)
        lit = above & ~hidden
        self.visibility[pixel] = lit.mean(axis=1, dtype=np.float64)
        self.standard_error[pixel] = self._standard_error(lit)

    def shadowed(
        self, hits: Hits, samples: Float32[HostArray, "n s 2"], occluders: AbstractTracer
    ) -> tuple[Bool[HostArray, "n s"], Bool[HostArray, "n s"]]:
        """Which of the light's `samples` (n, s, 2) lie above the horizon of each of `hits`, (n, s), and which of these
        are hidden by `occluders`, (n, s)."""
        start = self.tracer.start(hits)
        direction, height = self.lamp.vectors(start, hits.normal, samples.astype(self.tracer.dtype, copy=False))
        # Samples below the horizon are dark and need no ray.
        above = height > 0
        if above.all():
            which, direction = np.repeat(np.arange(len(above)), above.shape[1]), direction.reshape(-1, 3)
        else:
            # By index: NumPy takes five times as long to select rows by a mask.
            chosen = np.flatnonzero(above)
            which, direction = chosen // above.shape[1], np.take(direction.reshape(-1, 3), chosen, axis=0)
        hidden = np.zeros_like(above)
        if len(which):
            hidden[above] = occluders.occluded(ShadowRays(start, hits.face, which, direction, self.reach))
        return above, hidden

    def _standard_error(self, lit: Bool[HostArray, "n s"]) -> Float64[HostArray, " n"] | float:
        """Estimated from the two halves of the samples: var(mean) = (difference of halves)² · n₁ n₂ / (n₁ + n₂)²."""
        samples = lit.shape[1]
        if samples == 1:
            return 0.5 if self.lamp.has_size else 0.0
        half = samples // 2
        difference = lit[:, :half].mean(axis=1) - lit[:, half:].mean(axis=1)
        return np.abs(difference) * np.sqrt(half * (samples - half)) / samples


def blocking_faces(scene: Scene, blockers: Blockers) -> Bool[HostArray, " f"]:
    """Which faces of the scene's mesh block shadow rays."""
    return np.ones(len(scene.casting_faces), bool) if blockers == "all" else scene.casting_faces


def _nothing_seen(scene: Scene, rays: CameraRays, triangles: Triangles) -> str:
    """The message that the camera misses the scene: where each of them is, and how to mend it."""
    corners = triangles.to_world(triangles.corners).reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    view, camera = rays.view, scene.camera
    matrix = np.asarray(view.world_to_eye)
    distance = -(corners @ matrix[2, :3] + matrix[2, 3])
    near, far = float(view.near), float(view.far)
    # In the world, where coordinates may be large.
    brief = lambda point: [float(f"{x:.4g}") + at for x, at in zip(np.asarray(point), scene.origin, strict=True)]
    if distance.max() < near or distance.min() > far:
        remedy = (
            "turn the camera round"
            if distance.max() < 0 and view.is_perspective
            else "set near and far to enclose the scene, or move the camera"
        )
    else:
        remedy = f"point its target at the scene, whose middle is {brief((low + high) / 2)}, or widen its view"
    return (
        f"the camera at {brief(camera.eye)}, looking at {brief(camera.target)}, sees no surface: its near and far are "
        f"{near:.4g} and {far:.4g}, and the scene spans {brief(low)} to {brief(high)}, "
        f"at distances {distance.min():.4g} to {distance.max():.4g}; expected a surface at one or more of its "
        f"{rays.height * rays.width} pixel centres: {remedy}"
    )
