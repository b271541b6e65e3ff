"""Folders of runs that somebody has damaged or edited: one message each, whatever is wrong, and never a traceback."""

import contextlib
import copy
import io as text_io
import json
import os
import shutil
import struct
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from rich.console import Console
from scenes import staying_in
from stored_runs import write_fit, write_render, write_sweep

from diffshadow import io, study
from diffshadow.cli import main
from diffshadow.config import load_sweep, parse_config
from diffshadow.study.record._files import read_record
from diffshadow.study.record._stored import read_run
from diffshadow.study.record._sweeps import Outcome
from diffshadow.study.sweeps import _work as sweep_work

DELETED = object()
WRONG = [
    *(DELETED, None, "text", "", {}, [], [[1]], {"a": 1}, True, -1, 0, 7, 0.5),
    *(10**400, 1e308, -1e308, float("nan"), float("inf"), "\x1b[31m\n\x00\x85", "\ud800", "$\\frac"),
]
Path_ = tuple[str | int, ...]


def run(*arguments: Any) -> int:
    """The exit code of the command."""
    with pytest.raises(SystemExit) as caught:
        main(list(map(str, arguments)))
    return caught.value.code


@pytest.fixture
def told(capsys) -> Callable[..., str]:
    """Runs the command, which does what it should or says in one plain line why not. Returns that line."""

    def check(*arguments: Any) -> str:
        code, (out, err) = run(*arguments), capsys.readouterr()
        assert code in (0, 2), (arguments, code)
        assert len(err.splitlines()) == (code == 2), err
        assert (out + err).replace("\n", "").isprintable()
        assert code == 0 or (err.startswith("error: ") and len(err) < 800), err
        return err

    return check


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> dict[str, Path]:
    """A folder of each kind that is as it should be. Tests damage copies."""
    home = tmp_path_factory.mktemp("runs")
    small = "scene: {meshes: [path: 'builtin:torus'], camera: {resolution: [6, 8]}, lights: [{}, {azimuth: 9}]}"
    return {
        "fit": write_fit(home / "fit"),
        "render": write_render(home / "render", parse_config(small, name="small")),
        "sweep": write_sweep(home / "sweep"),
    }


def copied(folder: Path, to: Path) -> Path:
    shutil.rmtree(to, ignore_errors=True)
    return shutil.copytree(folder, to)


def key_paths(value: Any, at: Path_ = ()) -> Iterator[Path_]:
    """The way to every value inside `value`."""
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value if isinstance(value, list) else ()):
        yield (*at, key)
        yield from key_paths(inner, (*at, key))


def changed(value: Any, path: Path_, new: Any) -> Any:
    """A copy of `value` with something else at `path`, or nothing."""
    value = holder = copy.deepcopy(value)
    for key in path[:-1]:
        holder = holder[key]
    if new is DELETED:
        del holder[path[-1]]
    else:
        holder[path[-1]] = new
    return value


def put(folder: Path, result: Any) -> None:
    (folder / "result.json").write_text(json.dumps(result))


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", ["fit", "render", "sweep"])
def test_every_value_of_a_result_may_be_wrong(kind, runs, told, tmp_path):
    good = json.loads((runs[kind] / "result.json").read_text())
    folder = copied(runs[kind], tmp_path / "run")
    taken: dict[Path_, list[Any]] = {}
    for path in key_paths(good):
        for wrong in WRONG:
            put(folder, changed(good, path, wrong))
            with contextlib.suppress(io.FileError):
                read_record(folder) if kind == "sweep" else read_run(folder)
                taken.setdefault(path, []).append(wrong)
    # What is read without an objection can be reported and compared, many such values at once.
    assert taken
    leaves = [path for path in taken if not any(other[: len(path)] == path != other for other in taken)]
    for turn in range(max(len(taken[path]) for path in leaves)):
        result = good
        for path in reversed(leaves):
            result = changed(result, path, taken[path][turn % len(taken[path])])
        put(folder, result)
        told("report", folder)
        if kind != "sweep":
            told("compare", folder, runs[kind], "--output", tmp_path / "page.html")


@pytest.mark.parametrize("path", [("metrics",), ("metrics", "pixels"), ("seconds",), ("fitted", "bias.constant")])
def test_message_names_file_key_and_what_was_expected(path, runs, told, tmp_path):
    folder = copied(runs["fit"], tmp_path / "run")
    put(folder, changed(json.loads((folder / "result.json").read_text()), path, "text"))
    error = told("report", folder)
    expected = {1: "a section with keys", 2: "a number"}[len(path)] if path[-1] != "pixels" else "a whole number"
    assert f'result.json is damaged: {".".join(path)} is "text"; expected {expected}: run it again' in error


def test_parts_of_a_result_that_disagree_are_reported(runs, told, tmp_path):
    folder = copied(runs["fit"], tmp_path / "run")
    good = json.loads((folder / "result.json").read_text())
    for path, new, said in (
        (("solver", "chosen_phase"), 2, "solver.chosen_phase: is 2; expected less than 2, the number of phases"),
        (
            ("initial",),
            {"bias.constant": 1.0},
            "initial: has the keys bias.constant; expected the keys of fitted, bias.constant, filter.radius",
        ),
        (
            ("bounds", "filter.radius", "upper"),
            0.0,
            "bounds.filter.radius: are 0 and 0; expected lower less",
        ),
        (("metrics", "lights", 0, "light"), "scene.lights.7", "holds files of different runs"),
        (("metrics", "pixels"), 7, "640 pixels count in the array mask; expected the 7 of result.json"),
    ):
        put(folder, changed(good, path, new))
        assert said in told("report", folder)


def archive(change: Callable[[dict[str, np.ndarray]], Any]) -> Callable[[Path], None]:
    """What changes the arrays of a run."""

    def harm(folder: Path) -> None:
        with np.load(folder / "arrays.npz") as stored:
            arrays = {name: stored[name] for name in stored.files}
        change(arrays)
        np.savez(folder / "arrays.npz", **arrays)

    return harm


def member(name: str, content: bytes) -> Callable[[Path], None]:
    """What replaces one array of a run by these bytes."""

    def harm(folder: Path) -> None:
        with zipfile.ZipFile(folder / "arrays.npz") as old:
            kept = {info.filename: old.read(info) for info in old.infolist()}
        with zipfile.ZipFile(folder / "arrays.npz", "w") as new:
            for file, data in {**kept, f"{name}.npy": content}.items():
                new.writestr(file, data)

    return harm


def header(shape: tuple[int, ...], kind: str = "<f4", magic: bytes = b"\x93NUMPY\x01\x00") -> bytes:
    words = str({"descr": kind, "fortran_order": False, "shape": shape}).encode().ljust(117) + b"\n"
    return magic + struct.pack("<H", len(words)) + words


HARMS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "missing": (archive(lambda a: a.pop("mask")), "it has no array mask"),
    "shape": (archive(lambda a: a.update(after=a["after"][:, :5])), "the array after has the shape 24 × 5; expected"),
    "dimensions": (archive(lambda a: a.update(after=a["after"][None])), "has the shape 1 × 24 × 32; expected 24 × 32"),
    "history": (archive(lambda a: a.update(history_loss=a["history_loss"][1:])), "the arrays differ in length"),
    "columns": (archive(lambda a: a.update(history_values=a["history_values"][:, 1:])), "12 × 1; expected n × 2"),
    "phase": (
        archive(lambda a: a["history_phase"].fill(2)),
        "has phases that result.json does not list; expected 0 to 1",
    ),
    "empty": (archive(lambda a: a.update({k: v[:0] for k, v in a.items() if "history" in k})), "expected n"),
    "text": (archive(lambda a: a.update(after=a["after"].astype("U"))), "holds <U32; expected real numbers of 32 bits"),
    "complex": (archive(lambda a: a.update(after=a["after"] + 1j)), "the array after holds complex64"),
    "mask": (archive(lambda a: a.update(mask=a["mask"].astype(np.uint8))), "holds uint8; expected booleans"),
    "unmasked": (archive(lambda a: a["mask"].fill(False)), "0 pixels count in the array mask; expected the 640"),
    "picture": (archive(lambda a: a.update(shaded_after=a["shaded_after"][..., :2])), "expected 24 × 32 × 3"),
    "not a number": (archive(lambda a: a["after"].fill(np.nan)), "holds values from nan to nan; expected 0 to 1"),
    "infinite": (archive(lambda a: a["reference"].fill(np.inf)), "reference holds values from inf to inf"),
    "range": (archive(lambda a: a["before"].fill(2)), "before holds values from 2 to 2; expected 0 to 1"),
    "huge": (member("after", header((10**6, 10**6))), "the array after has the shape 1000000 × 1000000"),
    "huge history": (member("history_loss", header((2**40,))), "the array history_loss has the shape 1099511627776"),
    "long history": (member("history_loss", header((2**24,))), "has 0 bytes; expected the 67,108,864 of its shape"),
    "negative": (member("after", header((-24, -32))), "has the shape -24 × -32"),
    "half": (member("after", header((24, 32)) + bytes(24 * 32 * 2)), "has 1,536 bytes; expected the 3,072"),
    "object": (member("after", header((24, 32), "|O")), "the array after holds object"),
    "format": (member("after", header((24, 32), magic=b"\x93NUMPY\x09\x00")), "of NumPy's format (9, 0)"),
    "no header": (member("after", b"nonsense"), "the magic string is not correct"),
    "cut": (lambda f: os.truncate(f / "arrays.npz", 5000), "is damaged (File is not a zip file)"),
    "folder": (lambda f: ((f / "arrays.npz").unlink(), (f / "arrays.npz").mkdir()), "holds an incomplete run"),
    "pipe": (lambda f: ((f / "arrays.npz").unlink(), os.mkfifo(f / "arrays.npz")), "holds an incomplete run"),
}


@pytest.mark.parametrize("harm", HARMS)
def test_arrays_are_checked_before_memory_is_taken(harm, runs, told, tmp_path):
    folder = copied(runs["fit"], tmp_path / "run")
    apply, said = HARMS[harm]
    apply(folder)
    assert said in told("report", folder)
    assert said in told("compare", runs["fit"], folder)


def test_member_that_is_larger_than_it_says_is_refused(runs, told, tmp_path):
    """Sizes in the archive's directory that suit the header, and content that does not."""
    folder = copied(runs["fit"], tmp_path / "run")
    member("after", header((24, 32)) + bytes(24 * 32 * 4))(folder)
    content = bytearray((folder / "arrays.npz").read_bytes())
    at = content.rindex(b"after.npy") - 46
    packed, size = struct.unpack_from("<II", content, at + 20)
    struct.pack_into("<II", content, at + 20, packed - 4, size)
    (folder / "arrays.npz").write_bytes(content)
    assert "arrays.npz is damaged" in told("report", folder)


@pytest.mark.exhaustive
def test_history_that_is_not_finite_is_drawn(runs, told, tmp_path):
    """A fit may pass through places where nothing can be computed."""
    folder = copied(runs["fit"], tmp_path / "run")
    archive(lambda a: (a["history_loss"][:3].fill(np.nan), a["history_values"][2:5].fill(np.inf)))(folder)
    assert told("report", folder, "--figures", "svg") == ""


def test_other_files_of_a_folder_do_no_harm(runs, told, tmp_path):
    folder = copied(runs["fit"], tmp_path / "run")
    (folder / "folder.png").mkdir()
    (folder / "nowhere.svg").symlink_to("nothing")
    os.mkfifo(folder / "pipe.png")
    (folder / "half.png").write_bytes(b"\x89PNG")
    assert told("report", folder) == ""


def test_flipped_bytes_of_any_file_are_no_traceback(runs, told, tmp_path):
    rng = np.random.default_rng(5)
    for kind, names in (("fit", ("result.json", "arrays.npz", "config.yaml")), ("sweep", ("results.parquet",))):
        for name in names:
            good = (runs[kind] / name).read_bytes()
            for _ in range(6):
                folder = copied(runs[kind], tmp_path / "run")
                content = bytearray(good)
                for at in rng.integers(len(content), size=3):
                    content[at] ^= int(rng.integers(1, 256))
                (folder / name).write_bytes(content)
                code = run("report", folder)
                assert code in (0, 2)


# Sweeps.

SWEEP = """
name: s
scene: {meshes: [path: 'builtin:box'], camera: {resolution: [8, 8]}}
sweep: {grid: {filter.radius: [1, 2, 3, 4]}, plot: {x: filter.radius}}
"""


@pytest.fixture
def counted(monkeypatch, tmp_path) -> Iterator[list[float]]:
    """The radii of the runs that a sweep does; they take no time."""
    done: list[float] = []

    def measure(config, batch, stages):
        done.append(config.filter.radius)
        errors = dict.fromkeys(("rmse", "mae", "ssim", "false_shadow_rate", "false_light_rate"), 0.25)
        return {**errors, "rmse": config.filter.radius / 9, "reference_noise_floor": None, "pixels": 9}

    monkeypatch.setitem(sweep_work._MEASURES, "render", measure)
    with staying_in(tmp_path):
        Path("s.yaml").write_text(SWEEP)
        yield done


def swept() -> list[Path]:
    """The folders of a sweep's runs, which is done in this process."""
    sweep = load_sweep(Path("s.yaml"))
    folder = study.run_sweep(sweep, console=Console(file=text_io.StringIO()), workers=0)
    assert pa.parquet.read_table(folder / "results.parquet")["rmse"].to_pylist() == [1 / 9, 2 / 9, 3 / 9, 4 / 9]
    return [folder / "runs" / run.id for run in sweep.runs]


@pytest.mark.exhaustive
def test_sweep_does_a_run_again_whose_result_is_wrong_anywhere(counted):
    places = swept()
    good = json.loads((places[0] / "result.json").read_text())
    settings = load_sweep(Path("s.yaml")).settings
    sweep_folder, kept = places[0].parent.parent, 0
    for path in key_paths(
        {name: good[name] for name in Outcome.model_fields if name in ("id", "status", "error", "metrics", "seconds")}
    ):
        for wrong in WRONG:
            result = changed(good, path, wrong)
            put(places[0], result)
            outcome = sweep_work.read_outcome(sweep_folder, good["id"], settings, failed=True)
            if outcome is not None and result != good:
                kept += 1
                # Only a number for a number, or none.
                assert path[0] in ("metrics", "seconds"), (path, wrong)
                assert len(path) == 2 or path == ("seconds",), (path, wrong)
    assert kept > 0
    for at, wrong in ((("metrics",), []), (("metrics", "rmse"), "text"), (("metrics", "rmse"), DELETED)):
        put(places[0], changed(good, at, wrong))
        del counted[:]
        swept()
        assert counted == [1.0]


def test_whatever_stands_in_a_run_s_place_is_no_result(counted, tmp_path):
    places = swept()
    for place in places:
        shutil.rmtree(place)
    places[0].write_text("a file")
    places[1].symlink_to("nothing")
    places[2].mkdir()
    (places[2] / "result.json").mkdir()
    (places[2] / "notes.txt").write_text("mine")
    away = tmp_path / "away"
    away.mkdir()
    places[3].symlink_to(away)
    del counted[:]
    assert swept() == places
    assert counted == [1.0, 2.0, 3.0, 4.0]
    assert (places[2] / "notes.txt").read_text() == "mine"
    # A link to a folder stays one.
    assert places[3].is_symlink()
    assert (away / "result.json").is_file()
    assert sorted(each.name for each in places[0].parent.iterdir()) == sorted(each.name for each in places)


def test_pipe_for_a_result_is_not_waited_for(counted):
    places = swept()
    (places[0] / "result.json").unlink()
    os.mkfifo(places[0] / "result.json")
    del counted[:]
    swept()
    assert counted == [1.0]


@pytest.mark.exhaustive
def test_run_that_is_not_unicode_is_named_all_the_same(counted, told, monkeypatch):
    """A folder's name may hold bytes that are no text, and a program's output must be some."""
    strange = os.fsdecode(b"b\xe4d")
    Path(strange).mkdir()
    monkeypatch.chdir(strange)
    shutil.copy("../s.yaml", "s.yaml")
    assert told("sweep", Path.cwd() / "s.yaml", "--workers", "0") == ""
    assert told("report", "runs/s-sweep") == ""
    assert "b\\udce4d" in (Path("runs/s-sweep/report.html")).read_text()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t.drop_columns("status"), "has no column status"),
        (lambda t: t.drop_columns("filter.radius"), "has no column filter.radius"),
        (lambda t: t.set_column(1, "id", pa.array(range(6))), "its column id holds int64; expected text"),
        (lambda t: t.set_column(1, "id", pa.array(["../../etc"] * 6)), "not identifiers"),
        (lambda t: t.set_column(6, "rmse", pa.array(list("abcdef"))), "its column rmse holds string; expected numbers"),
        (lambda t: t.set_column(6, "rmse", pa.array([[1.0]] * 6)), "its column rmse holds list"),
        (lambda t: t.set_column(6, "rmse", pa.array([np.inf] * 6)), "its column rmse holds inf"),
        (lambda t: t.append_column("rmse", t["rmse"]), "two columns with the same name"),
        (lambda t: t.slice(0, 0), None),
    ],
)
def test_table_of_a_sweep_is_checked(change, said, runs, told, tmp_path):
    folder = copied(runs["sweep"], tmp_path / "run")
    file = folder / "results.parquet"
    pa.parquet.write_table(change(pa.parquet.read_table(file)), file)
    error = told("report", folder)
    assert error == "" if said is None else (said in error and "results.parquet is damaged" in error), error


def test_damaged_configuration_of_a_run_costs_a_sweep_only_its_settings(runs, told, tmp_path):
    folder = copied(runs["sweep"], tmp_path / "run")
    place = folder / "runs" / f"{0:016x}"
    place.mkdir(parents=True)
    (place / "config.yaml").write_text("sede: 1")
    assert told("report", folder) == ""


def test_damaged_entry_of_the_cache_is_computed_again(tmp_path):
    arrays = io.cached_arrays(["key"], lambda: {"a": np.ones(3)}, tmp_path)
    (entry,) = tmp_path.glob("*.npz")
    with zipfile.ZipFile(entry, "w") as new:
        # More than any machine has.
        new.writestr("_a.npy", header((10**12,), "<f8"))
    again = io.cached_arrays(["key"], lambda: {"a": np.ones(3)}, tmp_path)
    np.testing.assert_array_equal(again["a"], arrays["a"])
