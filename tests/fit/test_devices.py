"""Fits whose views are shared among devices."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import covered, floor_and_card, free_port, problem, shadows, sun, technique

from diffshadow.fit import Search, TechniqueProblem
from diffshadow.fit.problems import compressed
from diffshadow.fit.problems._devices import devices_of
from diffshadow.shadow import (
    RandomDisk,
    draw_shadow_map,
    stratified,
)

ROOT = Path(__file__).parents[2]
PARTS = [(0.5, -1.0, -0.3), (-0.4, -1.0, 0.5), (0.2, -1.0, 0.4), (-0.3, -1.0, -0.2), (0.1, -1.0, 0.6)]
# Uses so many devices: of this process, or of as many processes with one device each.
START = """
import json, sys
import jax
devices, pixels, number = map(int, sys.argv[1:4])
if number < 0:
    jax.config.update("jax_num_cpu_devices", devices)
else:
    jax.distributed.initialize(sys.argv[4], devices, number)
from test_devices import views
from diffshadow.fit import Anneal, Loss, Parameter, Search, Solver, fit
"""
# Fits, and prints what it found.
FITS = """
found = []
for solver, loss in (("levenberg_marquardt", Loss()), ("levenberg_marquardt", Loss("worst")), ("adam", Loss())):
    bounds = [Parameter("bias.constant", 1.0, 0.0, 6.0), Parameter("filter.radius", 1.5, 0.0, 8.0)]
    result = fit(
        views(), bounds, solver=Solver(solver, 12, 1e-6, 1e-8), anneal=Anneal(1.0, 0.2, 2), loss=loss,
        search=Search(devices=devices, pixels=pixels), on_step=lambda step: None,
    )
    deviations = list(result.precision.deviations.values())
    found.append([*result.fitted.values(), *result.errors, len(result.history), *deviations])
print(json.dumps(found))
"""


def views() -> list[TechniqueProblem]:
    """Five views under as many suns, two of them with smaller images."""
    disk = lambda radius, bias: technique(RandomDisk(radius, stratified((2, 2))), bias)
    mesh, found = floor_and_card(), []
    large, small = (problem(disk(2.0, 1.6), image=side) for side in (64, 48))
    for number, direction in enumerate(PARTS):
        base = small if number in (1, 4) else large
        surface = base.surface
        shadow_map = draw_shadow_map(mesh, sun(mesh, direction), (64, 64))
        truth = shadows(disk(2.4 + number / 4, 1.2), shadow_map, surface)
        mask = np.array(covered(disk(2.0, 1.6), shadow_map, surface))
        mask[: 4 * number] = False
        found.append(TechniqueProblem(base.technique, shadow_map, surface, truth, jnp.asarray(mask)))
    return found


def test_few_rows_have_the_products_of_all():
    random = np.random.default_rng(1)
    images = [random.normal(size=(2, 5, 3)).astype(np.float32), random.normal(size=(1, 2, 2)).astype(np.float32)]
    slopes = [random.normal(size=(2, *each.shape)).astype(np.float32) for each in images]
    rows, jacobian = compressed([jnp.asarray(i) for i in images], [jnp.asarray(s) for s in slopes], 1)
    flat = np.concatenate([image.ravel() for image in images])
    columns = np.concatenate([stack.reshape(2, -1) for stack in slopes], axis=1).T
    assert len(rows) == 3 + 3
    np.testing.assert_allclose(jacobian.T @ jacobian, columns.T @ columns, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(jacobian.T @ rows, columns.T @ flat, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(rows @ rows, flat @ flat, rtol=1e-5)


def test_more_devices_than_there_are_refused():
    assert devices_of(1) == 1
    with pytest.raises(ValueError, match=r"devices is 4000, and JAX sees \d+"):
        devices_of(4000)
    with pytest.raises(ValueError, match=r"Search\.devices is -1"):
        Search(devices=-1)


def test_several_processes_share_all_devices_or_none(monkeypatch):
    monkeypatch.setattr("jax.process_count", lambda: 2)
    monkeypatch.setattr("jax.device_count", lambda: 4)
    assert (devices_of(0), devices_of(4), devices_of(1)) == (4, 4, 1)
    with pytest.raises(ValueError, match="devices is 2, and 2 processes of JAX have 4; expected 0 or 4"):
        devices_of(2)


@pytest.mark.exhaustive
@pytest.mark.parametrize("pixels", [1600, 1 << 20], ids=["of a sample", "of all pixels"])
def test_two_devices_fit_what_one_does(pixels):
    one, two = (_fitted(devices, pixels) for devices in (1, 2))
    _check_equal(two, one)


@pytest.mark.exhaustive
def test_two_processes_fit_what_one_does():
    one = _fitted(1, 1600)
    port = free_port()
    first, second = map(_found, [_started(FITS, 2, 1600, number, port) for number in range(2)])
    _check_equal(first, one)
    # Both know the result, and the first alone the steps.
    assert [[*each[:4], *each[5:]] for each in second] == [[*each[:4], *each[5:]] for each in first]
    assert [each[4] for each in second] == [0, 0, 0]


def _check_equal(two: list[list[float]], one: list[list[float]]) -> None:
    # Sums over the views are in another order, and a solver may end elsewhere in a flat valley.
    np.testing.assert_allclose([each[:2] for each in two], [each[:2] for each in one], rtol=5e-4)
    # The solver may end a step sooner or later. Deviations follow from the final Jacobian.
    np.testing.assert_allclose([each[4] for each in two], [each[4] for each in one], atol=3)
    for part in (slice(2, 4), slice(5, None)):
        np.testing.assert_allclose([each[part] for each in two], [each[part] for each in one], rtol=0.02)


def _fitted(devices: int, pixels: int) -> list[list[float]]:
    return _found(_started(FITS, devices, pixels))


def _started(fits: str, devices: int, pixels: int, number: int = -1, port: int = 0) -> subprocess.Popen:
    path = os.pathsep.join(map(str, (ROOT, ROOT / "tests", ROOT / "tests" / "fit")))
    arguments = map(str, (devices, pixels, number, f"127.0.0.1:{port}"))
    command = [sys.executable, "-c", START + fits, *arguments]
    return subprocess.Popen(
        command, env={**os.environ, "PYTHONPATH": path}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def _found(process: subprocess.Popen) -> list[list[float]]:
    out, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    return json.loads(out.splitlines()[-1])
