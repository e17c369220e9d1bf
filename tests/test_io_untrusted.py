"""Files made to harm: they cost one message, no memory, no time, nothing outside their folder."""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import os
import resource
import subprocess
import sys
import tarfile
import time
import zlib
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from fuzz.inputs import INPUTS, write_inputs
from fuzz.runner import fuzz

from pointsdf_cli.errors import InputError
from pointsdf_cli.io import input_files
from pointsdf_cli.io.checkpoints import read_train_state
from pointsdf_cli.io.describe import describe
from pointsdf_cli.io.hdf5 import read_artifact, write_artifact
from pointsdf_cli.io.labels import Labels, read_labels, write_labels
from pointsdf_cli.io.layout import Column
from pointsdf_cli.io.poses import camera_pose
from pointsdf_cli.io.trials import read_trial
from pointsdf_cli.io.untrusted import (
    is_whole_number,
    parse_json,
    read_json,
    read_npy_array,
    read_xml,
    read_yaml,
)
from pointsdf_cli.objects.archive import extract_mesh
from pointsdf_cli.robot.urdf import read_urdf

SQUEEZED = {"depth": Column("f4 [*, *, *]", "m", compress=True)}


@pytest.fixture(autouse=True)
def _quick() -> object:
    started = time.monotonic()
    yield
    assert time.monotonic() - started < 60


def test_the_undamaged_files_are_read(tmp_path: Path) -> None:
    # What the fuzzer damages must be good: else it would only ever test the first check.
    write_inputs(tmp_path)
    for kind in INPUTS:
        assert kind.read(tmp_path / kind.name) is not None, kind.name


def test_damaged_files_are_read_or_refused() -> None:
    # A slice of `python -m tests.fuzz`; docs/scaling.md has the run over 20 000 files.
    outcome = fuzz(first=1_000_000, count=300, seed=1)
    assert outcome.failures == []
    assert outcome.refused + outcome.read == 300
    assert outcome.read > 10  # or the damages would be too coarse to reach anything


def test_yaml_aliases_of_aliases(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)]
    (tmp_path / "bomb.yaml").write_text("\n".join(lines))
    with pytest.raises(InputError, match="aliases"):
        read_yaml(tmp_path / "bomb.yaml")
    (tmp_path / "ring.yaml").write_text("&a [*a]")
    with pytest.raises(InputError, match="aliases"):
        read_yaml(tmp_path / "ring.yaml")


def test_yaml_merges_of_merges(tmp_path: Path) -> None:
    # `<<` copies what an alias leads to while the file is read: 9 to the 11th copies.
    lines = ["a: &c0 {b: 1}"]
    lines += [f"c{k}: &c{k} {{<<: [{', '.join([f'*c{k - 1}'] * 9)}]}}" for k in range(1, 12)]
    (tmp_path / "bomb.yaml").write_text("\n".join(lines))
    started = time.process_time()
    for first_document in (False, True):
        with pytest.raises(InputError, match="aliases"):
            read_yaml(tmp_path / "bomb.yaml", first_document)
    assert time.process_time() - started < 10
    (tmp_path / "good.yaml").write_text("a: &a {x: 1}\nb: {<<: *a, y: 2}\n")
    assert read_yaml(tmp_path / "good.yaml") == {"a": {"x": 1}, "b": {"x": 1, "y": 2}}


@pytest.mark.parametrize("text", ["home: [0]\nurdf: a\nhome: [1]\n", "b: [{home: 1, 'home': 2}]"])
def test_a_yaml_key_that_stands_twice_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(InputError, match="`home` stands a second time, in line"):
        read_yaml(tmp_path / "a.yaml")
    (tmp_path / "a.yaml").write_text("a: {x: 1}\nb: {x: 1}\n1: a\n'1': b\n")
    assert read_yaml(tmp_path / "a.yaml") == {"a": {"x": 1}, "b": {"x": 1}, 1: "a", "1": "b"}


def test_yaml_makes_no_python_objects(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("!!python/object/apply:os.system ['touch owned']")
    with pytest.raises(InputError, match="not YAML"):
        read_yaml(tmp_path / "a.yaml")


@pytest.mark.parametrize("text", ["[" * 3_000, '{"a":' * 9_000, "\x00", "2026-99-99", "\\ud800"])
def test_deep_and_odd_text(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(InputError):
        read_json(tmp_path / "a.json")
    (tmp_path / "a.yaml").write_text(text)
    with contextlib.suppress(InputError):
        assert isinstance(read_yaml(tmp_path / "a.yaml"), (str, dict))


def test_xml_entities_of_entities(tmp_path: Path) -> None:
    entities = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10 if k else "x"}">' for k in range(12))
    bomb = f"<!DOCTYPE robot [{entities}]><robot name='&e11;'/>"
    outside = "<!DOCTYPE r [<!ENTITY x SYSTEM 'file:///etc/passwd'>]><robot>&x;</robot>"
    for text in (bomb, outside):
        for encoding in ("utf-8", "utf-16"):
            (tmp_path / "a.urdf").write_bytes(text.encode(encoding))
            with pytest.raises(InputError, match="entities"):
                read_xml(tmp_path / "a.urdf")
    (tmp_path / "deep.urdf").write_text("<a>" * 100_000)
    with pytest.raises(InputError, match="nest"):
        read_xml(tmp_path / "deep.urdf")


def test_an_array_that_promises_terabytes(tmp_path: Path) -> None:
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999, 3), }"
    size = np.array([len(header)], "<u2").tobytes()
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x01\x00" + size + header)
    with pytest.raises(InputError, match="cut short"):
        read_npy_array(tmp_path / "a.npy")
    np.save(tmp_path / "objects.npy", np.array([{}], dtype=object))
    with pytest.raises(InputError):
        read_npy_array(tmp_path / "objects.npy")


@pytest.mark.parametrize("kind", ["|V0", "|S0", "<U0"])
def test_an_array_of_values_without_a_size(tmp_path: Path, kind: str) -> None:
    # Any number of them fits into the file, and becomes terabytes where they are taken for numbers.
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': (99999999999999, 3), }}"
    size = np.array([len(header)], "<u2").tobytes()
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x01\x00" + size + header.encode() + bytes(99))
    with pytest.raises(InputError, match="is not a NumPy array"):
        camera_pose(str(tmp_path / "a.npy"))


@pytest.mark.parametrize(
    "part", ["<link name='l{}'/>", "<joint name='j{}'/>", "<link><collision/></link>"]
)
def test_a_robot_of_more_parts_than_any_has(tmp_path: Path, part: str) -> None:
    parts = "".join(part.format(number) for number in range(30_000))
    (tmp_path / "a.urdf").write_text(f"<robot>{parts}</robot>")
    started = time.process_time()
    with pytest.raises(InputError, match="has 30000 <"):
        read_urdf(tmp_path / "a.urdf")
    assert time.process_time() - started < 10


def test_a_dataset_that_promises_terabytes(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["schema"], file.attrs["schema_version"] = "labels", 1
        file.create_dataset("sdf", shape=(1 << 40,), dtype="f4", chunks=(1 << 16,))
    with pytest.raises(InputError, match="bytes that are not there"):
        read_artifact(tmp_path / "a.h5", schema="labels", version=1)


def test_a_chunk_that_unpacks_to_more_than_it_holds(tmp_path: Path) -> None:
    # A chunk of 12 kB whose stream unpacks to 600 MB; 3 MB of stream would take 3 GB of memory.
    packer, zeros = zlib.compressobj(6), bytes(1 << 22)
    stream = b"".join(packer.compress(zeros) for _ in range(150)) + packer.flush()
    with packed_file(tmp_path / "a.h5", [6]) as chunk:
        chunk.write_direct_chunk((0, 0), stream)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match="points unpacks to more than it holds"):
        read_artifact(tmp_path / "a.h5", schema="labels", version=1)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB


def test_a_json_key_that_stands_twice_is_refused() -> None:
    with pytest.raises(InputError, match="`fx` stands a second time"):
        parse_json('{"fx": 150, "fy": 150, "fx": 75}', "K.json")


@pytest.mark.parametrize("text", ["²", "٣", "1" * 5000, "", "-1", "1.0"])
def test_what_int_cannot_take_is_no_whole_number(text: str) -> None:
    assert not is_whole_number(text)
    assert is_whole_number("17")


def test_a_dataset_that_is_packed_twice(tmp_path: Path) -> None:
    with packed_file(tmp_path / "a.h5", [9, 9]) as chunk:  # a million to one
        chunk.write_direct_chunk((0, 0), zlib.compress(zlib.compress(bytes(12_000))))
    with pytest.raises(InputError, match="packed in a way"):
        read_artifact(tmp_path / "a.h5", schema="labels", version=1)


def test_large_chunks_as_rgrasp_writes_them_are_read(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).random((1000, 300, 3))
    with packed_file(tmp_path / "a.h5", [1], shape=noise.shape) as chunk:
        h5py.Dataset(chunk)[...] = noise
    assert (tmp_path / "a.h5").stat().st_size > 3_000_000
    found = read_artifact(tmp_path / "a.h5", schema="labels", version=1)
    np.testing.assert_array_equal(found.datasets["points"], noise.astype(np.float32))


@contextlib.contextmanager
def packed_file(
    path: Path, levels: list[int], shape: tuple[int, ...] = (1000, 3)
) -> Iterator[h5py.h5d.DatasetID]:
    """A file whose dataset `points` is one chunk with these gzip filters."""
    with h5py.File(path, "w") as file:
        file.attrs["schema"], file.attrs["schema_version"] = "labels", 1
        made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        made.set_chunk(shape)
        for level in levels:
            made.set_deflate(level)
        space = h5py.h5s.create_simple(shape)
        yield h5py.h5d.create(file.id, b"points", h5py.h5t.NATIVE_FLOAT, space, made)


def test_a_heap_of_strings_that_never_ends(tmp_path: Path) -> None:
    # libhdf5 walks from string to string; one of index 0 and size 0 would hold it for ever.
    path = tmp_path / "a.h5"
    layout = {"x": Column("f8 [3]")}
    write_artifact(path, schema="s", version=1, layout=layout, arrays={"x": np.zeros(3)})
    data = bytearray(path.read_bytes())
    at = data.index(b"GCOL") + 16
    while int.from_bytes(data[at : at + 2], "little"):
        at += 16 + -(-int.from_bytes(data[at + 8 : at + 16], "little") // 8) * 8
    data[at + 8 : at + 16] = bytes(8)
    path.write_bytes(data)
    with pytest.raises(InputError, match="heap"):
        read_artifact(path, schema="s", version=1)


def test_a_well_squeezed_dataset_is_read(tmp_path: Path) -> None:
    zeros = {"depth": np.zeros((4, 500, 500), np.float32)}
    write_artifact(tmp_path / "a.h5", schema="s", version=1, layout=SQUEEZED, arrays=zeros)
    assert (tmp_path / "a.h5").stat().st_size < 100_000
    assert read_artifact(tmp_path / "a.h5", schema="s", version=1).datasets["depth"].size == 10**6


@pytest.mark.parametrize(
    ("layout", "told"),
    [
        ({"points": Column("f4 [N, 4]")}, "points is float32"),
        ({"points": Column("i4 [N, 3]")}, "points is float32"),
        ({"points": Column("f4 [N, 3]"), "sdf": Column("f4 [N]")}, "sdf is float32.*\n.*N = 5"),
        ({"group": Column("f4 [N]")}, "is a group"),
    ],
)
def test_what_is_not_of_its_layout_is_named(
    tmp_path: Path, layout: dict[str, Column], told: str
) -> None:
    write_artifact(
        tmp_path / "a.h5", schema="s", version=1,
        layout={"points": Column("f4 [5, 3]"), "sdf": Column("f4 [4]")},
        arrays={"points": np.zeros((5, 3), np.float32), "sdf": np.zeros(4, np.float32)},
    )  # fmt: skip
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file.create_group("group")
    with pytest.raises(InputError, match=told):
        read_artifact(tmp_path / "a.h5", schema="s", version=1, names=layout)
    good = {"points": Column("f4 [N, 3]"), "sdf": Column("f4 [*]")}
    assert set(read_artifact(tmp_path / "a.h5", schema="s", version=1, names=good).datasets) == set(
        good
    )


class _Owns:
    """Pickles as a call that would leave a file behind."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.path,))


def test_a_training_state_runs_no_code(tmp_path: Path) -> None:
    owned = tmp_path / "owned"
    torch.save({"step": 1, "payload": _Owns(owned)}, tmp_path / "train_state.pt")
    with pytest.raises(InputError, match="not opened"):
        read_train_state(tmp_path)
    assert not owned.exists()


def test_a_checkpoint_with_pickled_weights_is_not_opened(tmp_path: Path) -> None:
    from pointsdf_cli.models.registry import load_model

    owned = tmp_path / "owned"
    torch.save(_Owns(owned), tmp_path / "model.safetensors")
    about = {"schema": "checkpoint", "schema_version": 1, "architecture": "pointsdf-ray"}
    (tmp_path / "config.json").write_text(json.dumps({**about, "model": {}}))
    with pytest.raises(InputError):
        load_model(tmp_path)
    assert not owned.exists()


@pytest.mark.parametrize("name", ["../../evil.ply", "/tmp/evil.ply", "a/../../../nontextured.ply"])
def test_an_archive_writes_nowhere_else(tmp_path: Path, name: str) -> None:
    from fuzz.inputs import tar_of

    (tmp_path / "in").mkdir()
    archive = tmp_path / "in" / "a.tgz"
    archive.write_bytes(tar_of({name: b"x", "nontextured.ply": b"ply"}))
    with pytest.raises(InputError, match="leads outside"):
        extract_mesh(archive, tmp_path / "in" / "mesh")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a.tgz", "in"]


def test_a_damaged_archive_is_one_message(tmp_path: Path) -> None:
    archive = tmp_path / "a.tgz"
    with tarfile.open(archive, "w:gz") as tar:
        info = tarfile.TarInfo("nontextured.ply")
        contents = np.random.default_rng(0).integers(0, 20, 5000, dtype=np.uint8).tobytes()
        info.size = len(contents)
        tar.addfile(info, io.BytesIO(contents))
    whole, refused = archive.read_bytes(), 0
    for place in range(12, len(whole), 7):
        archive.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        try:
            extract_mesh(archive, tmp_path / "mesh")
        except InputError:
            refused += 1
    assert refused > 100


def test_an_archive_of_zeros_is_not_unpacked(tmp_path: Path) -> None:
    archive = tmp_path / "a.tgz"
    with gzip.open(archive, "wb") as packed, tarfile.open(fileobj=packed, mode="w|") as tar:
        info = tarfile.TarInfo("nontextured.ply")
        info.size = 64 << 20
        with open("/dev/zero", "rb") as zeros:
            tar.addfile(info, zeros)
    assert archive.stat().st_size < 1 << 20
    with pytest.raises(InputError, match="unpacks to"):
        extract_mesh(archive, tmp_path / "mesh", largest=1 << 20)
    assert [p.name for p in tmp_path.iterdir()] == ["a.tgz"]


def test_every_schema_is_fuzzed(tmp_path: Path) -> None:
    """A new artifact needs a line in tests/fuzz/artifacts.py."""
    import ast

    import pointsdf_cli

    schemas = set()
    for module in Path(pointsdf_cli.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Assign):
                continue
            for target in node.targets:
                names = target.elts if isinstance(target, ast.Tuple) else [target]
                values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                for name, value in zip(names, values, strict=False):
                    is_schema = isinstance(name, ast.Name) and name.id.endswith("SCHEMA")
                    if is_schema and isinstance(value, ast.Constant):
                        schemas.add(value.value)
    assert {"views", "plan", "trial", "checkpoint"} <= schemas, "else nothing was found"
    write_inputs(tmp_path)
    fuzzed = set()
    for kind in INPUTS:
        path = tmp_path / kind.name
        if path.suffix == ".h5":
            with h5py.File(path) as file:
                fuzzed.add(file.attrs["schema"])
        elif path.name == "config.json":
            fuzzed.add(json.loads(path.read_text())["schema"])
    assert schemas - fuzzed == set()


def test_every_suffix_that_is_read_is_fuzzed() -> None:
    from pointsdf_cli.io.clouds import CLOUD_SUFFIXES
    from pointsdf_cli.io.depth_images import DEPTH_SUFFIXES
    from pointsdf_cli.io.meshes import MESH_SUFFIXES

    same = {".tif": ".tiff", ".txt": ".xyz"}
    wanted = {same.get(s, s) for s in (*CLOUD_SUFFIXES, *MESH_SUFFIXES, *DEPTH_SUFFIXES)}
    assert wanted - {Path(kind.name).suffix for kind in INPUTS} == set()


def _elsewhere(folder: Path) -> dict[str, object]:
    """Ways in which an HDF5 file holds what is in another file, as functions on an open file."""
    secret = folder / "secret.txt"
    secret.write_bytes(b"secret0123456789secret!!")
    with h5py.File(folder / "other.h5", "w") as other:
        other["points"] = np.zeros((2, 3), np.float32)

    def virtual(file: h5py.File) -> None:
        layout = h5py.VirtualLayout((2, 3), "f4")
        layout[:] = h5py.VirtualSource(folder / "other.h5", "points", (2, 3))
        file.create_virtual_dataset("points", layout)

    def below(file: h5py.File) -> None:
        file["group/points"] = h5py.ExternalLink(str(folder / "other.h5"), "/points")

    return {
        "external storage": lambda file: file.create_dataset(
            "points", (2, 3), "f4", external=[(str(secret), 0, 24)]
        ),
        "external link": lambda file: file.__setitem__(
            "points", h5py.ExternalLink(str(folder / "other.h5"), "/points")
        ),
        "soft link": lambda file: file.__setitem__("points", h5py.SoftLink("/else/points")),
        "virtual": virtual,
        "in a group": below,
    }


def test_labels_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    sdf = np.array([0.0, np.nan], np.float32)
    write_labels(
        tmp_path / "a.h5", Labels(np.zeros((2, 3), np.float32), sdf, "m", "0" * 64), seed=0
    )
    with pytest.raises(InputError, match="NaN or infinite"):
        read_labels(tmp_path / "a.h5")


@pytest.mark.parametrize(
    "way", ["external storage", "external link", "soft link", "virtual", "in a group"]
)
def test_hdf5_reaches_no_other_file(tmp_path: Path, way: str) -> None:
    from conftest import run_cli

    path = tmp_path / "a.h5"
    labels = Labels(np.zeros((2, 3), np.float32), np.zeros(2, np.float32), "m", "0" * 64)
    write_labels(path, labels, seed=0)
    with h5py.File(path, "a") as file:
        del file["points"]
        _elsewhere(tmp_path)[way](file)  # type: ignore[operator]
    refused = "is a link|in another file"
    for read in (read_labels, describe):
        with pytest.raises(InputError, match=refused):
            read(path)
    for command in ("info", "report", "view"):
        more = ["--export", tmp_path / "page.html"] if command == "view" else []
        run = run_cli(command, path, *more)
        assert run.code == 2
        assert "secret" not in run.out + run.err.replace(str(tmp_path), "")
        assert not list(tmp_path.glob("*.html"))


def test_a_virtual_dataset_of_a_pipe_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["schema"], file.attrs["schema_version"] = "labels", 1
        layout = h5py.VirtualLayout((2,), "f4", maxshape=(None,))
        source = h5py.VirtualSource(tmp_path / "pipe.h5", "x", (2,), maxshape=(None,))
        layout[: h5py.h5s.UNLIMITED] = source[: h5py.h5s.UNLIMITED]
        file.create_virtual_dataset("points", layout)
        file["sdf"] = h5py.ExternalLink(str(tmp_path / "pipe.h5"), "/x")
    code = f"from pointsdf_cli.io.describe import describe; describe({str(tmp_path / 'a.h5')!r})"
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert "InputError" in run.stderr


def test_groups_within_groups_cost_a_message(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "deep.h5", "w") as file:
        group = file
        for _ in range(8000):
            group = group.create_group("a")
    with h5py.File(tmp_path / "ring.h5", "w") as file:
        file.create_group("a")["b"] = file["/"]
    with h5py.File(tmp_path / "many.h5", "w") as file:
        for number in range(10_001):
            file.create_group(f"{number}")
    with h5py.File(tmp_path / "attributes.h5", "w", libver="latest") as file:
        for number in range(1001):
            file.attrs[f"{number}"] = 0
    for name, told in (
        ("deep", "nest deeper than 8"), ("ring", "holds itself"), ("many", "more than 10000"),
        ("attributes", "1001 attributes"),
    ):  # fmt: skip
        started = time.process_time()
        with pytest.raises(InputError, match=told):
            describe(tmp_path / f"{name}.h5")
        assert time.process_time() - started < 5


def test_a_little_gzip_that_unpacks_to_much_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A megabyte of zeros is a kilobyte; what is stored bounds what is read by a thousand only.
    zeros = {"depth": np.zeros((4, 1000, 500), np.float32)}
    write_artifact(tmp_path / "a.h5", schema="s", version=1, layout=SQUEEZED, arrays=zeros)
    monkeypatch.setitem(input_files.LARGEST, "artifact", 1 << 20)  # type: ignore[misc]
    with pytest.raises(InputError, match="unpacks to 7 MB"):
        read_artifact(tmp_path / "a.h5", schema="s", version=1)


def test_a_trial_that_disagrees_with_itself_is_refused(tmp_path: Path) -> None:
    write_inputs(tmp_path)
    path, whole = tmp_path / "trial.h5", (tmp_path / "trial.h5").read_bytes()
    spoilt = {
        "q": np.zeros((3, 6)), "q ": np.zeros((0, 6)), "faces": np.full((1, 3), 99, np.int32),
        "T_world_object": np.zeros((0, 4, 4)), "times": np.zeros(9), "phases": np.array([b"a"] * 5),
        "cloud": np.zeros((4, 2), np.float32),
    }  # fmt: skip
    for name, array in spoilt.items():
        path.write_bytes(whole)
        with h5py.File(path, "a") as file:
            del file[name.strip()]
            file[name.strip()] = array
        with pytest.raises(InputError, match=r"trial\.h5"):
            read_trial(path)
    for wrong in ({"yaw": "north"}, {"held": 1}, {"object": None}, {"seed": 0.5}):
        path.write_bytes(whole)
        with h5py.File(path, "a") as file:
            row = json.loads(file.attrs["row_json"]) | wrong
            file.attrs["row_json"] = json.dumps(row)
        with pytest.raises(InputError, match=str(*wrong)):
            read_trial(path)


def test_an_obstacle_beyond_all_measure_does_not_crash(tmp_path: Path) -> None:
    from pointsdf_cli.planning.environment import read_environment

    write_inputs(tmp_path)
    for scale in ("1e308", "1e-300", "1e6"):
        (tmp_path / "world" / "environment.yaml").write_text(
            f"obstacles: [{{mesh: box.stl, scale: {scale}}}]"
        )
        with pytest.raises(InputError, match="m across"):
            read_environment(tmp_path / "world" / "environment.yaml")


def test_grasps_of_other_joints_than_they_name_are_refused(tmp_path: Path) -> None:
    from pointsdf_cli.io.grasps import read_grasps

    write_inputs(tmp_path)
    with h5py.File(tmp_path / "grasps.h5", "a") as file:
        q = file["q"][:, :2]
        del file["q"]
        file["q"] = q
    with pytest.raises(InputError, match="6 joints, q of 2"):
        read_grasps(tmp_path / "grasps.h5")


def test_rows_of_commas_are_no_poses(tmp_path: Path) -> None:
    from pointsdf_cli.io.robot_poses import read_robot_poses

    path = tmp_path / "poses.csv"
    path.write_text(",,,\n")
    with pytest.raises(InputError, match="no poses"):
        read_robot_poses(path)
    path.write_text("a.png,0.1,0.2,0.3,1,0,0,0\n,,,,,,,\n")
    assert read_robot_poses(path).names == ("a.png",)
