"""Remarks on how maps are laid out: what they have no memory or no level for."""

from collections.abc import Iterator, Sequence

from ... import shadow
from .._drawn import Drawn


def layout_remarks(
    technique: shadow.AbstractTechnique | shadow.FittableTechnique, drawn: Sequence[Drawn]
) -> Iterator[str]:
    """A sentence for each light and each remark of the layout of `technique`, if it has one."""
    if not isinstance(technique, shadow.ShadowMapping):
        return
    for each in drawn:
        for remark in technique.layout.remarks(each.state.light):
            yield f"{each.key} {remark}"
