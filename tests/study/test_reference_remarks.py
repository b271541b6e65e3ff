"""Remarks on references: lights without shadow or without light, and shadows that are not meant to be dark."""

from types import SimpleNamespace

import numpy as np
import pytest

from diffshadow.config import parse_config
from diffshadow.study.remarks._reference import reference_remarks

LIT = np.array([[1.0, 1.0], [1.0, 0.0]])
MASK = np.array([[True, True], [True, False]])


def remarks(visibility, text=""):
    config = parse_config(f"scene: {{meshes: [{{path: builtin:box}}], camera: {{eye: [0, 0, 5]}}}}\n{text}")
    drawn = SimpleNamespace(key="scene.light", reference=SimpleNamespace(visibility=visibility), mask=MASK)
    return list(reference_remarks(config, [drawn]))


@pytest.mark.parametrize(
    ("visibility", "said"),
    [(0 * LIT, "reaches no pixel of the reference"), (LIT, "casts no shadow into the reference"), (LIT / 2, None)],
    ids=["dark", "lit", "penumbra"],
)
def test_a_reference_without_shadow_or_light_is_remarked_on(visibility, said):
    found = remarks(visibility)
    assert (len(found) == 1 and found[0].startswith(f"scene.light {said}")) if said else found == []


@pytest.mark.parametrize(("text", "is_said"), [("intensity: 0.8", True), ("intensity: 1", False)])
def test_shadows_that_are_not_dark_are_remarked_on(text, is_said):
    found = remarks(LIT / 2, f"technique: {{type: three.js, {text}}}")
    assert [remark.startswith("technique.intensity is 0.8") for remark in found] == [True] * is_said
