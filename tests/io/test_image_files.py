"""Images, whole-or-nothing writes and the cache on disk."""

import errno
import io
import os
import struct
import tracemalloc
import warnings
import zlib
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import OpenEXR
import pytest
from PIL import Image

from diffshadow.io import (
    FileError,
    FullDiskError,
    atomic_path,
    cache_folder,
    cache_key,
    cache_size,
    cached_arrays,
    check_writable,
    clear_cache,
    naming_full_disks,
    prune_cache,
    read_visibility,
    write_png,
    write_visibility,
)

RAMP = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
SUFFIXES = [".npy", ".png", ".exr"]


def write_exr(path, **channels):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, channels) as exr:
        exr.write(str(path))


def encoded(levels, suffix):
    file = io.BytesIO()
    Image.fromarray(levels).save(file, Image.registered_extensions()[suffix])
    return file.getvalue()


def levels_of(path):
    with Image.open(path) as image:
        return np.asarray(image)


# Images


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_visibility_round_trips(suffix, tmp_path):
    path = tmp_path / f"visibility{suffix}"
    write_visibility(path, jnp.asarray(RAMP))
    read = read_visibility(path)
    assert read.dtype == np.float32
    if suffix == ".png":
        np.testing.assert_allclose(read, RAMP, atol=0.5 / 65535 + 1e-7)
    else:
        np.testing.assert_array_equal(read, RAMP)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_hard_visibility_round_trips_to_the_bit(suffix, tmp_path):
    hard = (RAMP > 0.4).astype(bool)
    path = tmp_path / f"hard{suffix.upper()}"
    write_visibility(path, hard)
    np.testing.assert_array_equal(read_visibility(str(path)), hard)


def test_files_of_images_begin_with_the_top_row_and_arrays_with_the_bottom(tmp_path):
    write_visibility(tmp_path / "a.png", RAMP)
    write_visibility(tmp_path / "a.npy", RAMP)
    write_visibility(tmp_path / "a.exr", RAMP)
    assert levels_of(tmp_path / "a.png")[-1, 0] == 0
    assert np.load(tmp_path / "a.npy")[0, 0] == 0
    with OpenEXR.File(str(tmp_path / "a.exr")) as exr:
        assert exr.channels()["Y"].pixels[-1, 0] == 0


def test_png_of_grey_and_colour_is_flipped_and_rounded(tmp_path):
    write_png(tmp_path / "grey.png", RAMP)
    np.testing.assert_array_equal(levels_of(tmp_path / "grey.png")[::-1], np.rint(RAMP * 255))
    colour = np.stack([RAMP, 1 - RAMP, 0 * RAMP], axis=-1)
    write_png(tmp_path / "colour.png", jnp.asarray(colour))
    np.testing.assert_array_equal(levels_of(tmp_path / "colour.png")[::-1], np.rint(colour * 255))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_missing_and_damaged_images_are_refused(suffix, tmp_path, capfd):
    write_visibility(tmp_path / f"reference{suffix}", RAMP)
    with pytest.raises(FileError, match=rf"did you mean 'reference\{suffix}'"):
        read_visibility(tmp_path / f"refrence{suffix}")
    (tmp_path / f"bad{suffix}").write_bytes(b"garbage")
    with pytest.raises(FileError, match=rf"bad\{suffix} is damaged or does not have the format"):
        read_visibility(tmp_path / f"bad{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(FileError, match="is a folder"):
        read_visibility(tmp_path / f"folder{suffix}")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_truncated_images_are_refused(suffix, tmp_path, capfd):
    path = tmp_path / f"a{suffix}"
    write_visibility(path, np.random.default_rng(0).uniform(size=(64, 64)))
    whole = path.read_bytes()
    for size in (9, len(whole) // 2, len(whole) - 99):
        path.write_bytes(whole[:size])
        with pytest.raises(FileError, match="is damaged") as caught:
            read_visibility(path)
        assert "\n" not in str(caught.value)
    # OpenEXR writes what it finds to the terminal if nobody keeps it from that.
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_files_of_another_kind_than_their_suffix_says_are_named_for_what_they_are(suffix, tmp_path, capfd):
    path = tmp_path / f"a{suffix}"
    levels = np.rint(RAMP * 255).astype(np.uint8)
    for kind in [".jpg", ".gif", ".bmp", ".tif", ".webp", *SUFFIXES]:
        if kind == suffix:
            continue
        if kind in SUFFIXES:
            write_visibility(tmp_path / f"b{kind}", RAMP)
        else:
            (tmp_path / f"b{kind}").write_bytes(encoded(levels, kind))
        path.write_bytes((tmp_path / f"b{kind}").read_bytes())
        with pytest.raises(FileError, match=rf"its suffix \(it is a {kind} file\); write it again$"):
            read_visibility(path)
    path.write_text("words\n" * 20)
    with pytest.raises(FileError, match=rf"\(it does not begin as a {suffix} file\); write it again$"):
        read_visibility(path)
    path.write_bytes(b"")
    with pytest.raises(FileError, match=r"\(it is empty\); write it again$"):
        read_visibility(path)
    assert capfd.readouterr() == ("", "")


def _with_png_size(whole, rows, columns):
    header = b"IHDR" + struct.pack(">II", columns, rows) + whole[24:29]
    return whole[:12] + header + struct.pack(">I", zlib.crc32(header)) + whole[33:]


def _with_exr_size(whole, rows, columns):
    place = whole.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    return whole[:place] + struct.pack("<4i", 0, 0, columns - 1, rows - 1) + whole[place + 16 :]


def _with_npy_size(whole, rows, columns):
    old, new = b"(3, 4), }", f"({rows}, {columns}), }}".encode()
    return whole.replace(old + b" " * (len(new) - len(old)), new)


@pytest.mark.parametrize(
    ("suffix", "change", "message"),
    [
        (".png", _with_png_size, r"has 90000 x 80000 pixels; expected 1 to 67,108,864 in total"),
        (".exr", _with_exr_size, r"has 90000 x 80000 pixels; expected 1 to 67,108,864 in total"),
        (".npy", _with_npy_size, r"has 48 bytes of numbers; expected the 28800000000 of its shape \(90000, 80000\)"),
    ],
)
def test_a_header_that_promises_too_much_is_refused_before_memory_is_taken(suffix, change, message, tmp_path, capfd):
    path = tmp_path / f"a{suffix}"
    write_visibility(path, RAMP)
    path.write_bytes(change(path.read_bytes(), 90000, 80000))
    tracemalloc.start()
    with pytest.raises(FileError, match=message):
        read_visibility(path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 1e7
    assert capfd.readouterr() == ("", "")


def test_unknown_suffixes_are_refused(tmp_path):
    (tmp_path / "a.gif").write_bytes(b"")
    for act, expected in (
        (
            lambda: read_visibility(tmp_path / "a.gif"),
            r"is '\.gif'; expected one of \.npy, \.png, \.jpg, \.jpeg, \.exr",
        ),
        (lambda: write_visibility(tmp_path / "a.jpg", RAMP), r"is '\.jpg'; expected one of \.npy, \.png, \.exr"),
    ):
        with pytest.raises(FileError, match=expected):
            act()


@pytest.mark.parametrize("values", [np.zeros((2, 3, 3)), np.zeros(4), np.zeros((0, 3)), np.float32(1)])
def test_arrays_of_another_shape_are_refused(values, tmp_path):
    np.save(tmp_path / "a.npy", values)
    with pytest.raises(FileError, match=r"array of shape .*expected \(h, w\)"):
        read_visibility(tmp_path / "a.npy")
    with pytest.raises(ValueError, match=r"the shape .*expected \(h, w\)"):
        write_visibility(tmp_path / "b.npy", values)
    assert not (tmp_path / "b.npy").exists()


@pytest.mark.parametrize(
    ("value", "message"),
    [(np.nan, "1 pixels that are NaN"), (np.inf, "1 pixels"), (1.5, "from 0 to 1.5"), (-0.1, "from -0.1 to 1")],
)
def test_values_outside_the_unit_range_are_refused(value, message, tmp_path):
    bad = RAMP.copy()
    bad[1, 1] = value
    np.save(tmp_path / "a.npy", bad)
    write_exr(tmp_path / "a.exr", Y=bad)
    for name in ("a.npy", "a.exr"):
        with pytest.raises(FileError, match=f"a{name[1:]} has (values )?{message}"):
            read_visibility(tmp_path / name)
    for write in (write_visibility, write_png):
        with pytest.raises(ValueError, match=message):
            write(tmp_path / "b.png", bad)
    assert not (tmp_path / "b.png").exists()


def test_numbers_beyond_single_precision_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.full((2, 2), 1e300))
    with pytest.raises(FileError, match="has 4 pixels that are NaN or infinite"):
        read_visibility(tmp_path / "a.npy")


def test_rounding_outside_the_unit_range_is_put_back(tmp_path):
    write_visibility(tmp_path / "a.npy", RAMP * np.float32(1.000001) - np.float32(5e-7))
    read = read_visibility(tmp_path / "a.npy")
    assert read.min() == 0
    assert read.max() <= 1


def test_arrays_of_objects_and_words_are_refused(tmp_path):
    np.save(tmp_path / "words.npy", np.full((2, 2), "lit"))
    with pytest.raises(FileError, match="expected real numbers"):
        read_visibility(tmp_path / "words.npy")
    np.save(tmp_path / "objects.npy", np.array([[None]]), allow_pickle=True)
    with pytest.raises(FileError, match="expected real numbers"):
        read_visibility(tmp_path / "objects.npy")


def test_png_of_another_shape_or_place_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"shape \(2, 2, 4\); expected"):
        write_png(tmp_path / "a.png", np.zeros((2, 2, 4)))
    with pytest.raises(FileError, match="nowhere is not a folder"):
        write_png(tmp_path / "nowhere" / "a.png", RAMP)
    assert list(tmp_path.iterdir()) == []


# Whole-or-nothing writes


def test_image_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch):
    path = tmp_path / "old.png"
    write_visibility(path, RAMP)
    before = path.read_bytes()

    def breaks_off(file, _):
        file.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("diffshadow.io._images._WRITERS", {".png": breaks_off})
    with pytest.raises(FileError, match="No space left on device"):
        write_visibility(path, RAMP)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_atomic_path_replaces_on_success(tmp_path):
    target = tmp_path / "result.txt"
    target.write_text("old")
    with atomic_path(target) as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".txt"
        temporary.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_is_an_error_with_the_path(code, tmp_path):
    """Also where a library raises an error of its own while it handles the system's, and around a whole folder."""
    target = tmp_path / "a.npz"
    target.write_bytes(b"old")

    def write_archive():
        with atomic_path(target) as temporary:
            temporary.write_bytes(b"ne")
            try:
                raise OSError(code, os.strerror(code))
            finally:
                raise ValueError("cannot close the archive")

    with pytest.raises(FullDiskError) as caught:
        write_archive()
    assert str(caught.value).startswith(f"cannot write {target}: {os.strerror(code)}; expected free space there")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"old"]
    with pytest.raises(FullDiskError) as caught, naming_full_disks(tmp_path / "run", "; 3 are kept"):
        write_visibility_on_a_full_disk(tmp_path / ".run-draft.npy", code)
    assert str(caught.value).startswith(f"cannot write {tmp_path / 'run'}: {os.strerror(code)}; expected")
    assert str(caught.value).endswith("; 3 are kept")
    # Other errors pass unchanged.
    with pytest.raises(PermissionError), atomic_path(target):
        raise PermissionError(errno.EACCES, "no")


def write_visibility_on_a_full_disk(path, code):
    with atomic_path(path):
        raise OSError(code, os.strerror(code))


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_atomic_path_leaves_the_old_file_on_failure(error, tmp_path):
    target = tmp_path / "result.txt"
    target.write_text("old")

    def fail():
        with atomic_path(target) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(error):
        fail()
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_atomic_path_says_what_is_wrong(tmp_path):
    with pytest.raises(FileError, match="nowhere is not a folder"), atomic_path(tmp_path / "nowhere" / "a"):
        pass
    with pytest.raises(FileError, match="it is a folder"), atomic_path(tmp_path):
        pass
    with pytest.raises(FileError, match="nothing was written"), atomic_path(tmp_path / "a"):
        pass


def test_check_writable_accepts_old_and_new_folders_and_leaves_nothing(tmp_path, monkeypatch):
    check_writable(tmp_path)
    check_writable(tmp_path / "runs" / "first")
    monkeypatch.chdir(tmp_path)
    check_writable("runs")
    assert list(tmp_path.iterdir()) == []


def test_check_writable_names_a_file_in_the_way(tmp_path):
    (tmp_path / "runs").write_text("")
    for folder in (tmp_path / "runs", tmp_path / "runs" / "first" / "second"):
        with pytest.raises(FileError, match=rf"{tmp_path}/runs exists and is not a folder"):
            check_writable(folder)
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    with pytest.raises(FileError, match="link exists and is not a folder"):
        check_writable(tmp_path / "link" / "run")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc, whose folders nobody can write to")
def test_check_writable_says_why_a_folder_cannot_be_made_or_written_to():
    for folder in ("/proc/diffshadow/runs", "/proc"):
        with pytest.raises(FileError, match=rf"cannot write to the folder {folder}: .+; check its permissions"):
            check_writable(folder)


# The cache


class Counted:
    """A computation that counts how often it is asked for."""

    def __init__(self, **arrays):
        self.arrays, self.calls = arrays, 0

    def __call__(self):
        self.calls += 1
        return self.arrays


def test_cache_computes_once_and_returns_the_same(tmp_path):
    compute = Counted(visibility=RAMP, file=np.arange(3), scalar=np.float64(0.5))
    first = cached_arrays(["scene", 3, RAMP], compute, tmp_path / "new" / "cache")
    second = cached_arrays(["scene", 3, RAMP], compute, tmp_path / "new" / "cache")
    assert compute.calls == 1
    for got in (first, second):
        assert got.keys() == compute.arrays.keys()
        for name, array in compute.arrays.items():
            np.testing.assert_array_equal(got[name], array)
            assert got[name].dtype == array.dtype


def test_cache_accepts_device_arrays(tmp_path):
    compute = Counted(a=jnp.asarray(RAMP))
    for _ in range(2):
        assert isinstance(cached_arrays(jnp.asarray(RAMP), compute, tmp_path)["a"], np.ndarray)
    assert compute.calls == 1


def test_keys_differ_wherever_the_content_does():
    a = np.arange(6, dtype=np.int32)
    parts = [
        None, True, False, 0, 1, 1.0, "1", "None", b"1", [], [[]], [1, [2]], [[1], 2], [1, 2], ["a", "b"], ["ab"],
        ["a", "", "b"], {}, {"a": 1}, {"a": 2}, {"b": 1}, {"a": {"b": 1}}, a, a.reshape(2, 3), a.reshape(3, 2),
        a.astype(np.int64), a.astype(np.float32), a + 1, np.float32(1), np.float64(1), [a, 1], a[:5],
    ]  # fmt: skip
    keys = [cache_key(part) for part in parts]
    assert len(set(keys)) == len(parts)


def test_keys_agree_where_the_content_does():
    a = np.arange(6, dtype=np.float32).reshape(2, 3)
    assert cache_key([a]) == cache_key([jnp.asarray(a)]) == cache_key((np.asfortranarray(a),))
    assert cache_key(a) == cache_key(a.astype(">f4"))
    assert cache_key({"a": 1, "b": 2}) == cache_key({"b": 2, "a": 1})


@pytest.mark.parametrize("part", [object(), [{"a": {1, 2}}], np.array([None]), lambda: 0])
def test_keys_of_unknown_content_are_refused(part):
    with pytest.raises(ValueError, match="content cannot be hashed"):
        cache_key(part)


@pytest.mark.parametrize("damage", ["empty", "garbage", "truncated", "flipped"])
def test_a_damaged_entry_is_recomputed(damage, tmp_path):
    compute = Counted(a=np.arange(1000.0))
    cached_arrays("key", compute, tmp_path)
    (entry,) = tmp_path.iterdir()
    whole = entry.read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]
    entry.write_bytes({"empty": b"", "garbage": b"x" * 99, "truncated": whole[:middle], "flipped": flipped}[damage])
    for _ in range(2):
        np.testing.assert_array_equal(cached_arrays("key", compute, tmp_path)["a"], np.arange(1000.0))
    assert compute.calls == 2


def test_an_unusable_folder_warns_and_computes_all_the_same(tmp_path):
    (tmp_path / "file").write_text("")
    compute = Counted(a=RAMP)
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.warns(UserWarning, match=r"cache folder .*cannot be used .*DIFFSHADOW_CACHE"):
            np.testing.assert_array_equal(cached_arrays("key", compute, folder)["a"], RAMP)
    assert compute.calls == 2


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc, whose folders nobody can write to")
def test_a_folder_that_exists_but_takes_no_files_warns():
    with pytest.warns(UserWarning, match="cache folder /proc cannot be used"):
        np.testing.assert_array_equal(cached_arrays("key", Counted(a=RAMP), "/proc")["a"], RAMP)


def test_an_error_of_the_computation_passes_through_and_is_not_stored(tmp_path):
    def fail():
        raise ValueError("no light")

    with pytest.raises(ValueError, match="no light"):
        cached_arrays("key", fail, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_folder_comes_from_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("DIFFSHADOW_CACHE", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert cache_folder() == tmp_path / ".cache" / "diffshadow"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_folder() == tmp_path / "xdg" / "diffshadow"
    monkeypatch.setenv("DIFFSHADOW_CACHE", str(tmp_path / "own"))
    assert cache_folder() == tmp_path / "own"
    cached_arrays("key", Counted(a=RAMP))
    assert [entry.suffix for entry in (tmp_path / "own").iterdir()] == [".npz"]


def test_pruning_removes_the_least_recently_used_and_nothing_else(tmp_path):
    stranger = tmp_path / "mine.npz"
    stranger.write_bytes(bytes(10_000))
    os.utime(stranger, (0, 0))
    computations = [Counted(a=np.full(1000, i)) for i in range(4)]
    for i, compute in enumerate(computations):
        cached_arrays(i, compute, tmp_path)
        os.utime(tmp_path / f"{cache_key(i)}.npz", (1000 + i, 1000 + i))
    # A hit makes the oldest entry the newest.
    cached_arrays(0, computations[0], tmp_path)
    size = (tmp_path / f"{cache_key(0)}.npz").stat().st_size
    prune_cache(tmp_path, limit=2 * size)
    kept = {entry.name for entry in tmp_path.iterdir()}
    assert kept == {"mine.npz", f"{cache_key(0)}.npz", f"{cache_key(3)}.npz"}
    prune_cache(tmp_path, limit=0)
    assert {entry.name for entry in tmp_path.iterdir()} == {"mine.npz", f"{cache_key(0)}.npz"}


def test_a_folder_is_pruned_once_enough_was_added(tmp_path, monkeypatch):
    pruned = []
    monkeypatch.setattr("diffshadow.io._cache.prune_cache", pruned.append)
    monkeypatch.setattr("diffshadow.io._cache._BETWEEN", 20_000)
    for i in range(12):
        cached_arrays(i, Counted(a=np.full(1000, i)), tmp_path)
    # With the first entry, and then with every third: each has 8 kB and a bit.
    assert len(pruned) == 4


def test_compiled_programs_are_pruned_by_the_day_of_their_last_use(tmp_path):
    program = lambda name: tmp_path / f"jit_draw-{name * 64}-cache"
    for i, name in enumerate("abc"):
        program(name).write_bytes(bytes(100))
        # Written in this order, but the first was read last.
        os.utime(program(name), (5000 if name == "a" else 1000 + i, 1000 + i))
    (tmp_path / "notes.txt").write_bytes(bytes(1000))
    assert cache_size(tmp_path) == (3, 300)
    prune_cache(tmp_path, limit=200)
    assert sorted(path.name for path in tmp_path.iterdir()) == [program("a").name, program("c").name, "notes.txt"]
    clear_cache(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    assert cache_size(tmp_path / "missing") == (0, 0)


def test_pruning_removes_what_killed_writers_left(tmp_path):
    cached_arrays("key", Counted(a=RAMP), tmp_path)
    left = tmp_path / f".{cache_key('other')}-0123456789ab.npz"
    left.write_bytes(bytes(100))
    os.utime(left, (0, 0))
    prune_cache(tmp_path, limit=200)
    assert not left.exists()


def test_a_usable_cache_is_silent(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cached_arrays("key", Counted(a=RAMP), tmp_path)
