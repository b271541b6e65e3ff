"""Records: made of what a fit found, written, and read again as the same."""

import json
from types import SimpleNamespace

import pytest
from pydantic import ValidationError

from diffshadow import fit
from diffshadow.study.record._files import content_of, read_record
from diffshadow.study.record._runs import (
    FrontPoint,
    PictureErrors,
    PictureMetrics,
    PictureRecord,
    Poses,
    Profile,
    Verdict,
)

NUMBERS = {"a": 1.5}
ERRORS = PictureErrors(rmse=0.25, mae=0.125)


def record(**more):
    """The record of a fit to a picture."""
    of = {"initial": NUMBERS, "fitted": NUMBERS, "truth": {}, "deviations": {"a": float("inf")}, "steps": 3}
    measured = PictureMetrics(before=ERRORS, after=ERRORS, pixels=4, resolution=[2, 2])
    bounds = {"a": {"lower": 0.0, "upper": 2.0, "unit": "texels"}}
    about = {"name": "tiny", "seconds": {"fitting": 0.5}, "versions": {}, "camera": {}, "encoding": "srgb"}
    said = Verdict(kind="fitted", sentence="it fell")
    return PictureRecord(**{**of, **about, "bounds": bounds, "metrics": measured, "verdict": said, **more})


def test_parts_take_what_a_fit_found():
    end = lambda value: fit.End(value, 0.2, value > 3)
    found = fit.Profile("a", (3.0, 0.1), [(2.0, float("inf")), (3.0, 0.1)], [fit.Interval(0.05, end(2.5), end(3.5))])
    profile = Profile.of(found)
    assert (profile.best.value, profile.best.error, profile.points) == (3.0, 0.1, [[2.0, None], [3.0, 0.1]])
    assert (profile.intervals[0].within, profile.intervals[0].upper.value) == (0.05, 3.5)
    assert (profile.intervals[0].lower.is_bound, profile.intervals[0].upper.is_bound) == (False, True)
    precision = fit.Precision(("a",), {"a": 0.1}, [[1.0]], [("a", "b")])
    poses = Poses.of(SimpleNamespace(precision=precision, enlargements=2), truth=NUMBERS)
    assert poses.precision is not None
    assert (poses.precision.names, poses.precision.undetermined) == (["a"], [["a", "b"]])
    assert (poses.enlargements, poses.truth) == (2, NUMBERS)
    point = FrontPoint.of(fit.FrontPoint((1.5,), 0.1, 0.2, 4.0, 0.3, True), values=NUMBERS)
    assert (point.false_shadow, point.false_light, point.ratio, point.rmse, point.is_knee) == (0.1, 0.2, 4.0, 0.3, True)


def test_a_record_is_read_as_it_was_written_and_its_verdict_comes_first(tmp_path):
    made = record(warnings=["b\udce4d"], seed=7, command="diffshadow fit it.yaml")
    (tmp_path / "result.json").write_bytes(content_of(made, ["arrays.npz"]))
    stored = json.loads((tmp_path / "result.json").read_text())
    assert list(stored)[:4] == ["schema_version", "verdict", "name", "kind"]
    assert list(stored)[-6:] == ["warnings", "seconds", "versions", "seed", "command", "files"]
    assert stored["deviations"] == {"a": None}
    assert stored["warnings"] == ["b\\udce4d"]
    assert stored["files"] == ["arrays.npz", "result.json"]
    expected = made.model_copy(update={"schema_version": 1, "files": stored["files"]})
    assert read_record(tmp_path) == expected


def test_keys_without_a_value_are_not_written():
    stored = json.loads(content_of(record()))
    assert not {"seed", "command"} & stored.keys()
    assert stored["metrics"]["before"]["flip"] is None


def test_a_record_whose_parts_disagree_cannot_be_made():
    with pytest.raises(ValidationError, match="initial: has the keys b; expected the keys of fitted, a"):
        record(initial={"b": 1.0})
