"""Shimmer over time, which no single image shows."""

import numpy as np
from numpy.typing import ArrayLike

from ._inputs import as_images, check_on_host


def flicker(visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Root mean square change of the error from one frame to the next, over a path of the camera or the light.

        flicker² = mean over frames and pixels of ((v[t+1] - r[t+1]) - (v[t] - r[t]))²

    A shadow that moves in the same way as in the reference does not count, and a constant error does not count. Flicker
    measures the crawling of jagged edges and of acne, which is more visible than a constant error.

    **Arguments:**

    - `visibility`, `reference`: (n, h, w), values in [0, 1], for at least two frames.
    - `mask`: (n, h, w), the pixels that count; all of them by default. A pixel counts in a pair of frames if it counts
        in both.

    **Raises** `ValueError` if there are fewer than two frames, shapes differ, two frames have no pixel in common, or a
    value in the mask is not finite.

    !!! Example

        ```python
        frames = np.stack([visibility, visibility])
        metrics.flicker(frames, np.stack([truth.visibility, truth.visibility]))  # 0.0
        ```
    """
    check_on_host(visibility, reference, mask)
    images, truths = np.asarray(visibility), np.asarray(reference)
    masks = np.ones(images.shape, bool) if mask is None else np.asarray(mask)
    if images.ndim != 3 or len(images) < 2 or not images.shape == truths.shape == masks.shape:
        raise ValueError(
            f"the visibility has shape {images.shape}, the reference {truths.shape} and the mask {masks.shape}; "
            "expected the same shape (frames, height, width), of at least two frames"
        )
    squares, count, before = 0.0, 0, None
    for each in zip(images, truths, masks, strict=True):
        image, truth, inside = as_images(*each)
        if before is not None:
            both = inside & before[1]
            if not both.any():
                raise ValueError("two frames have no pixel of the mask in common; expected some: take smaller steps")
            squares += float(np.sum((image - truth - before[0])[both] ** 2))
            count += int(both.sum())
        before = image - truth, inside
    return (squares / count) ** 0.5
