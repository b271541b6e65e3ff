"""Remarks on the limits of errors against a run's reference."""

from collections.abc import Iterator, Sequence

import numpy as np

from ...config import Config
from ...settings.engines import ThreeJs
from ...settings.reference import TracedReference
from .._drawn import Drawn


def reference_remarks(config: Config, drawn: Sequence[Drawn]) -> Iterator[str]:
    """A sentence for each light without any shadow or without any light in the pixels that count, and a sentence for
    shadows that are not dark on purpose."""
    for each in drawn:
        seen = np.asarray(each.reference.visibility)[each.mask]
        if seen.size and seen.max() <= 0:
            yield f"{each.key} reaches no pixel of the reference, so there is no shadow to compare: move the light"
        elif seen.size and seen.min() >= 1:
            yield f"{each.key} casts no shadow into the reference, so errors come from acne alone: move the light"
    technique = config.technique
    is_traced = isinstance(config.reference, TracedReference)
    if isinstance(technique, ThreeJs) and technique.intensity < 1 and is_traced:
        yield (
            f"technique.intensity is {technique.intensity:g}, and the reference's shadows are dark: the difference "
            "counts as false light; set it to 1 to compare shadows alone"
        )
