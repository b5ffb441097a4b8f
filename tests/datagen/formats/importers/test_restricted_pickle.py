import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datagen.errors import CorruptFile
from datagen.formats.import_request import ReadOptions
from datagen.formats.importers.obpose import find_obpose
from datagen.formats.importers.restricted_pickle import read_pickled_npy
from tests.paths import ROOT

HEADER = {"shape": (), "fortran_order": False, "descr": "|O"}
SAMPLE = ROOT.parent / "shared/data/formats/obpose_camera_info.npy"


def write(path: Path, payload: bytes) -> Path:
    """An NPY file of one object with this pickle."""
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, HEADER)
        file.write(payload)
    return path


def boxed(value: object) -> np.ndarray:
    box = np.empty((), object)
    box[()] = value
    return box


class Call:
    """Object whose pickle calls a function."""

    def __init__(self, function: Any, *arguments: Any):
        self.call = function, arguments

    def __reduce__(self) -> Any:
        return self.call


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_plain_values_and_arrays_survive(protocol: int, tmp_path: Path):
    value = {
        "text": "mug",
        "number": 1.5,
        "scalar": np.float32(2.5),
        "flags": [True, None, b"x"],
        "matrix": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "big endian": np.arange(3, dtype=">i4"),
        "mask": np.eye(3, dtype=bool),
        "names": np.array(["a", "bc"]),
        "objects": np.array([{"a": 1}, {"b": 2}], object),
    }
    read = read_pickled_npy(write(tmp_path / "a.npy", pickle.dumps(boxed(value), protocol=protocol)))
    assert {name: read[name] for name in ("text", "number", "scalar", "flags")} == {
        "text": "mug", "number": 1.5, "scalar": 2.5, "flags": [True, None, b"x"],
    }  # fmt: skip
    for name in ("matrix", "big endian", "mask", "names"):
        assert np.array_equal(read[name], value[name]), name
    assert read["objects"] == [{"a": 1}, {"b": 2}]


def test_numpy_save_is_read(tmp_path: Path):
    np.save(tmp_path / "list.npy", np.array([{"a": np.arange(3)}, {"a": np.ones(2)}], object), allow_pickle=True)
    first, second = read_pickled_npy(tmp_path / "list.npy")
    assert [each["a"].tolist() for each in (first, second)] == [[0, 1, 2], [1, 1]]
    np.save(tmp_path / "plain.npy", np.arange(4.0).reshape(2, 2))
    assert read_pickled_npy(tmp_path / "plain.npy").tolist() == [[0, 1], [2, 3]]


def test_a_hostile_pickle_runs_nothing(tmp_path: Path):
    victim, path = tmp_path / "victim", tmp_path / "a.npy"
    calls = [
        Call(os.mkdir, str(victim)),
        Call(os.system, f"mkdir {victim}"),
        Call(eval, f"__import__('os').mkdir({str(victim)!r})"),
        Call(exec, f"import os; os.mkdir({str(victim)!r})"),
        Call(getattr, "", "format"),
        Call(np.load, str(path)),
        Call(pickle.loads, pickle.dumps(1)),
        Call(__import__, "os"),
    ]
    for call in calls:
        for value in (call, {"rgb": call}, [np.array([call], object)]):
            write(path, pickle.dumps(boxed(value)))
            with pytest.raises(CorruptFile, match=r"names .*, which could run code"):
                read_pickled_npy(path)
    write(path, pickle.dumps(boxed(calls[0])))
    np.load(path, allow_pickle=True)  # the same file is dangerous elsewhere
    assert victim.exists()


GLOBAL = b"cnumpy.core.multiarray\n_reconstruct\n"
BOMBS = {
    "loop": b"\x80\x02]q\x00h\x00a.",
    "deep": b"\x80\x02" + b"]" * 50 + b"a" * 49 + b".",
    "shared": b"\x80\x02]q\x00" + b"".join(b"](" + b"h%c" % i * 10 + b"eq%c" % (i + 1) for i in range(20)) + b".",
    "extension": b"\x80\x02\x82\x01.",
    "persistent": b"\x80\x02N\x51.",
    "changed function": b"\x80\x02" + GLOBAL + b"}(U\x01a NU\x01bNub.",
    "changed function twice": b"\x80\x02" + GLOBAL + b"}U\x08__call__Nsb.",
    "shape": b"\x80\x02cnumpy.core.multiarray\nscalar\ncnumpy\ndtype\nU\x02O8\x85R]\x86R.",
    "structured": b"\x80\x02cnumpy\ndtype\nX\x08\x00\x00\x00(9,)f8,f\x85R.",
    "length": b"\x80\x02cnumpy.core.numeric\n_frombuffer\n(M\xff\xffcnumpy\ndtype\nU\x02f8\x85R(M\xff\xfftU\x01CtR.",
    "set": b"\x80\x04\x8f.",
    "truncated": pickle.dumps(boxed({"a": np.ones(9)}))[:-20],
    "empty": b"",
    "noise": bytes(range(256)),
}


@pytest.mark.parametrize("payload", BOMBS.values(), ids=BOMBS)
def test_other_damage_is_one_clear_error(payload: bytes, tmp_path: Path):
    with pytest.raises(CorruptFile, match=r"a\.npy is refused: .*numpy\.save"):
        read_pickled_npy(write(tmp_path / "a.npy", payload))


def test_a_huge_place_in_the_memo_takes_no_memory(tmp_path: Path):
    """The unpickler in C would reserve 16 GiB."""
    assert read_pickled_npy(write(tmp_path / "a.npy", b"\x80\x02Nr\xff\xff\xff\x7f.")) is None


def test_an_array_never_reads_beyond_its_bytes(tmp_path: Path):
    payload = pickle.dumps(boxed(np.ones(4)))
    shape = payload.replace(b"K\x04\x85", b"K\x40\x85")
    assert shape != payload
    with pytest.raises(CorruptFile, match="does not fit its bytes"):
        read_pickled_npy(write(tmp_path / "a.npy", shape))


@pytest.mark.skipif(not SAMPLE.exists(), reason="the shared data are not there")
def test_the_authors_camera_looks_down_at_the_table(tmp_path: Path):
    camera = read_pickled_npy(SAMPLE)
    assert camera["camera_intrinsics"][0, 0] == pytest.approx(-175.84, abs=0.01)
    frame = {"rgb": np.zeros((128, 128, 3)), "depth": np.full((128, 128), 1.0)}
    np.save(tmp_path / "0.npy", np.array(frame, object), allow_pickle=True)
    images = find_obpose(tmp_path, ReadOptions(camera=SAMPLE)).recordings[0].read([0])
    assert images.k[0, 0, :2].ravel().tolist() == pytest.approx([175.84, 0, 64.5, 0, 175.84, 64.5], abs=0.01)
    assert images.world_from_camera is not None
    pose = images.world_from_camera[0, 0]
    down = pose[:3, 2]
    assert (pose[:3, 3] - down * pose[2, 3] / down[2]).tolist() == pytest.approx([0.283, 0.012, 0], abs=0.002)
    assert pose[2, 1] < 0  # image rows count downwards
