"""Reasons of refused trials, each counted once and none lost."""

from pathlib import Path
from types import SimpleNamespace

from pointsdf_cli.errors import InputError
from pointsdf_cli.trials.experiment import _reasons


def test_each_reason_of_an_object_is_told() -> None:
    tasks = {
        f"{item}{k}": SimpleNamespace(trial=SimpleNamespace(object=SimpleNamespace(name=item)))
        for item, count in (("mug", 6), ("can", 2))
        for k in range(count)
    }
    where = Path("fork.ply")
    refused = {
        "mug0": InputError("never comes to rest", where=where),
        "mug1": InputError("has no faces", where=where),
        "mug2": InputError("never comes to rest", where=where),
        "can0": InputError("has no faces", where=where),
        "can1": InputError("has no faces", where=where),
    }
    found = _reasons(tasks, refused)  # type: ignore[arg-type]
    assert list(found) == ["mug, 3 of 6 trials", "can"]
    rest, faces = str(refused["mug0"]), str(refused["mug1"])
    assert found["mug, 3 of 6 trials"] == f"{rest} (2); {faces} (1)"
    assert found["can"] == faces
