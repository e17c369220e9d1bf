"""Artifacts: whole or absent, with provenance, refused when they are something else."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.atomic import (
    _builder,
    atomic_path,
    remove_leftovers,
    require_new,
    temporary_beside,
)
from pointsdf_cli.io.grasps import collection_of
from pointsdf_cli.io.hdf5 import (
    OptionsDifferError,
    artifacts_below,
    is_complete,
    mesh_unit,
    read_artifact,
    write_artifact,
)
from pointsdf_cli.io.layout import Column

NUMBERS = np.arange(12, dtype=np.float32).reshape(4, 3)


@pytest.fixture
def artifact(tmp_path: Path) -> Path:
    path = tmp_path / "a.h5"
    write_artifact(
        path,
        schema="views",
        version=1,
        layout={"cloud": Column("f4 [*, 3]", "m", "camera")},
        arrays={"cloud": NUMBERS},
        attributes={"noise": 0.001},
        seed=7,
        config={"views": 4},
    )
    return path


def test_every_promised_attribute_is_there(artifact: Path) -> None:
    with h5py.File(artifact) as file:
        for name in (
            "schema",
            "schema_version",
            "created_by",
            "git_commit",
            "seed",
            "config_json",
            "length_unit",
        ):
            assert name in file.attrs
        assert file.attrs["length_unit"] == "m"
        assert file["cloud"].attrs["units"] == "m"
        assert file["cloud"].attrs["frame"] == "camera"


def test_reading_gives_back_what_was_written(artifact: Path) -> None:
    read = read_artifact(artifact, schema="views", version=1)
    np.testing.assert_array_equal(read.datasets["cloud"], NUMBERS)
    assert read.attributes["seed"] == 7
    assert read.config == {"views": 4}


def test_equal_contents_make_equal_files(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_artifact(
            tmp_path / f"{name}.h5",
            schema="s",
            version=1,
            layout={"x": Column("f4 [*]")},
            arrays={"x": NUMBERS},
        )
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_another_schema_is_named(artifact: Path) -> None:
    with pytest.raises(InputError, match="holds views, and labels is needed"):
        read_artifact(artifact, schema="labels", version=1)


def test_an_older_version_is_named(artifact: Path) -> None:
    with pytest.raises(InputError, match="older version"):
        read_artifact(artifact, schema="views", version=2)


def test_a_missing_dataset_is_named(artifact: Path) -> None:
    with pytest.raises(InputError, match="lacks the dataset depth"):
        read_artifact(artifact, schema="views", version=1, names={"depth": Column("f4 [*]")})


@pytest.mark.parametrize("keep", [0, 10, 500, 1500])
def test_a_file_cut_short_is_an_input_error(artifact: Path, keep: int) -> None:
    artifact.write_bytes(artifact.read_bytes()[:keep])
    with pytest.raises(InputError, match="cut short"):
        read_artifact(artifact, schema="views", version=1)


def test_damaged_numbers_are_an_input_error(tmp_path: Path) -> None:
    path, numbers = tmp_path / "a.h5", np.random.default_rng(0).random((1000, 300, 3))
    write_artifact(path, "views", 1, {"cloud": Column("f8 [V, P, 3]")}, {"cloud": numbers})
    read = read_artifact(path, schema="views", version=1)
    np.testing.assert_array_equal(read.datasets["cloud"], numbers)
    whole = bytearray(path.read_bytes())
    middle = len(whole) // 2
    whole[middle : middle + 200] = bytes(200)
    path.write_bytes(whole)
    with pytest.raises(InputError, match="damaged"):
        read_artifact(path, schema="views", version=1)


@pytest.mark.parametrize(
    ("shape", "compress"),
    [((), False), ((0,), False), ((0, 3), True), ((3, 0), False), ((1,), True)],
)
def test_arrays_of_nothing_and_single_numbers_come_back(
    tmp_path: Path, shape: tuple[int, ...], compress: bool
) -> None:
    path, array = tmp_path / "a.h5", np.ones(shape)
    layout = {"a": Column("f8", compress=compress)}
    write_artifact(path, "views", 1, layout, {"a": array})
    np.testing.assert_array_equal(
        read_artifact(path, schema="views", version=1).datasets["a"], array
    )


def test_a_file_without_check_sums_is_read(artifact: Path) -> None:
    with h5py.File(artifact, "a") as file:
        told = dict(file["cloud"].attrs)
        assert file["cloud"].fletcher32
        del file["cloud"]
        file.create_dataset("cloud", data=NUMBERS).attrs.update(told)
    read = read_artifact(artifact, schema="views", version=1)
    np.testing.assert_array_equal(read.datasets["cloud"], NUMBERS)


def test_foreign_hdf5_is_known(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["data"] = NUMBERS
    with pytest.raises(InputError, match="no rgrasp artifact"):
        read_artifact(tmp_path / "x.h5", schema="views", version=1)


def test_a_finished_file_is_complete_only_for_the_same_options(artifact: Path) -> None:
    assert is_complete(artifact, schema="views", version=1, config={"views": 4})
    with pytest.raises(OptionsDifferError, match="views: 4 there, 5 now"):
        is_complete(artifact, schema="views", version=1, config={"views": 5})
    assert not is_complete(artifact.with_name("none.h5"), schema="views", version=1, config={})


@pytest.mark.parametrize("options", ["[", "7", "[1]"])
def test_options_that_are_none_are_one_message(artifact: Path, options: str) -> None:
    with h5py.File(artifact, "a") as file:
        file.attrs["config_json"] = options
    for read in (collection_of, lambda path: mesh_unit(h5py.File(path))):
        with pytest.raises(InputError, match=r"a\.h5.*makes no sense"):
            read(artifact)
    with pytest.raises(InputError, match="makes no sense"):
        is_complete(artifact, schema="views", version=1, config={})


def test_an_exception_while_writing_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    target = tmp_path / "t.txt"
    target.write_text("old")

    def write_half() -> None:
        with atomic_path(target) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_half()
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_leftovers_of_a_killed_run_are_removed_and_nothing_else(tmp_path: Path) -> None:
    kill = f"""
import os, signal
from pointsdf_cli.io.atomic import atomic_path
with atomic_path({str(tmp_path / "a.h5")!r}) as temporary:
    temporary.write_bytes(b"x")
    os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", kill], check=False).returncode == -9
    (killed,) = tmp_path.iterdir()
    (tmp_path / ".hidden").write_bytes(b"the user's")
    with atomic_path(tmp_path / "b.h5") as temporary:
        temporary.write_bytes(b"y")
        # Another machine's, or another container's on this one.
        elsewhere = tmp_path / re.sub(r"partial-.{8}", "partial-0123abcd", killed.name)
        elsewhere.write_bytes(b"z")
        remove_leftovers(tmp_path)
        left = {p.name for p in tmp_path.iterdir()}
        assert left == {".hidden", temporary.name, elsewhere.name}
    os.utime(elsewhere, (0, 0))
    remove_leftovers(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [".hidden", "b.h5"]


def test_what_only_looks_like_a_leftover_stays(tmp_path: Path) -> None:
    names = [".holiday.partial-2019.tar", ".a.partial-", ".a.partial-0123abcd-x-1-01234567.h5"]
    names += [".a.partial-0123abcd-7-1-01234567h5", "a.partial-0123abcd-7-1-01234567.h5"]
    names += [f".a.partial-0123abcd-{10**20}-1-01234567.h5"]
    for name in names:
        (tmp_path / name).write_bytes(b"x")
        os.utime(tmp_path / name, (0, 0))
    (tmp_path / ".a.partial-0123abcd-7-1-01234567.h5").mkdir()
    remove_leftovers(tmp_path)
    assert len(list(tmp_path.iterdir())) == len(names) + 1
    remove_leftovers(tmp_path / "none")  # no folder, nothing to remove


@pytest.mark.skipif(sys.platform != "linux", reason="a process's age is known under Linux only")
def test_a_number_that_another_process_has_by_now_builds_nothing(tmp_path: Path) -> None:
    mine = temporary_beside(tmp_path / "a.h5")
    host, process, began = _builder(os.getpid()).split("-")
    another = mine.name.replace(_builder(os.getpid()), f"{host}-{process}-{int(began) - 1}")
    for name in (mine.name, another):
        (tmp_path / name).write_bytes(b"x")
        os.utime(tmp_path / name, (0, 0))  # whatever a file server's clock says
    remove_leftovers(tmp_path)
    assert list(tmp_path.iterdir()) == [mine]


@pytest.mark.skipif(sys.platform != "linux", reason="zombies are told apart under Linux only")
def test_what_was_killed_and_not_asked_for_yet_builds_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-c", "input()"]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as builder:
        mine = temporary_beside(tmp_path / "a.h5").name
        theirs = tmp_path / mine.replace(_builder(os.getpid()), _builder(builder.pid))
        theirs.write_bytes(b"x")
        remove_leftovers(tmp_path)
        assert theirs.exists()
        builder.kill()
        # It has ended, and stays a process until its parent asks how.
        os.waitid(os.P_PID, builder.pid, os.WEXITED | os.WNOWAIT)
        os.kill(builder.pid, 0)
        remove_leftovers(tmp_path)
        assert not theirs.exists()


def test_a_name_as_long_as_names_may_be_is_written(tmp_path: Path) -> None:
    for name in ("n" * 252 + ".h5", "é" * 126 + ".h5"):
        with atomic_path(tmp_path / name) as temporary:
            temporary.write_text("new")
        assert (tmp_path / name).read_text() == "new"
    assert len(list(tmp_path.iterdir())) == 2


def test_an_input_is_not_replaced_even_with_force(tmp_path: Path) -> None:
    source, link = tmp_path / "a.ply", tmp_path / "b.ply"
    source.write_text("points")
    link.symlink_to(source)
    for out in (source, link):
        with pytest.raises(InputError, match="is an input"):
            require_new(out, True, [source])
    assert require_new(tmp_path / "c.ply", False, [source]) == tmp_path / "c.ply"


def test_nothing_is_overwritten_without_force(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("precious")
    with pytest.raises(InputError, match="--force"):
        require_new(tmp_path / "a", force=False)
    assert require_new(tmp_path / "a", force=True) == tmp_path / "a"


def test_only_ordinary_files_are_replaced_and_a_link_stays_a_link(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="not an ordinary file"):
        require_new(tmp_path / "pipe", force=True)
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "plan").write_text("old")
    (tmp_path / "plan").symlink_to(tmp_path / "far" / "plan")
    with atomic_path(tmp_path / "plan") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "plan").is_symlink()
    assert (tmp_path / "far" / "plan").read_text() == "new"


def test_one_wrong_byte_among_the_attributes_is_one_message(artifact: Path) -> None:
    # Elsewhere, too, but some versions of libhdf5 go round in circles: `python -m tests.fuzz`
    # gives each file a process.
    whole = artifact.read_bytes()
    refused, places = 0, range(whole.find(b"schema_version") - 40, whole.find(b"config_json") + 60)
    for at in places[::7]:
        artifact.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        for ask in (
            lambda: is_complete(artifact, schema="views", version=1, config={"views": 4}),
            lambda: collection_of(artifact),
        ):
            try:
                ask()
            except InputError:
                refused += 1
    assert refused > len(places) // 7, "else this test shows nothing"


def test_notes_beside_artifacts_are_none(artifact: Path) -> None:
    folder = artifact.parent
    (folder / "._a.h5").write_bytes(b"a Mac was here")
    (folder / ".trash").mkdir()
    shutil.copy(artifact, folder / ".trash" / "b.h5")
    (folder / "below").mkdir()
    shutil.copy(artifact, folder / "below" / "c.h5")
    assert artifacts_below(folder) == [artifact, folder / "below" / "c.h5"]
