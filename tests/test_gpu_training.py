"""pipelines/gpu on the CPU: its kernels, its batches against the package's, and a short run."""

import argparse
import ctypes
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import KDTree

from pointsdf_cli.camera.raycast import MeshCaster
from pointsdf_cli.camera.scene_views import SceneViewConfig, SceneViews
from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.geometry.signed_distance import SignedDistance
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.io.checkpoints import read_checkpoint, read_config
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.models.neighbours import nearest_neighbours
from pointsdf_cli.models.normalise import network_frame
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.models.surroundings import surroundings_of
from pointsdf_cli.objects.generate import make_object
from pointsdf_cli.training.sdf_config import TrainConfig

GPU = Path(__file__).parents[1] / "pipelines" / "gpu"
WEIGHTS = GPU.parents[1] / "assets" / "weights" / "pointsdf_real"
ON_CPU = """
#include <algorithm>
#include <cmath>
#define __global__
#define DIM 3
#define COUNT 8
struct Index { int x; };
static Index blockIdx, blockDim = {1}, threadIdx;
#include "KERNELS"
extern "C" void each_knn(const float* q, const float* p, long long* out, int a, int b, int c) {
    for (blockIdx.x = 0; blockIdx.x < a * c; ++blockIdx.x) knn(q, p, out, a, b, c);
}
extern "C" void each_sdf(const float* x, const float* t, float* out, int a, int b) {
    for (blockIdx.x = 0; blockIdx.x < a; ++blockIdx.x) sdf(x, t, out, a, b);
}
"""


@pytest.fixture
def gpu(monkeypatch):
    """The modules of pipelines/gpu can be imported."""
    monkeypatch.syspath_prepend(str(GPU))


def mug() -> LoadedMesh:
    """A generated mug, which has a cavity and a handle."""
    made = make_object(3, 0, ["mug"])
    return LoadedMesh(made.name, made.vertices.astype(np.float64), made.faces, "", "none")


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs a C++ compiler: apt install g++")
def test_kernels_find_neighbours_and_signed_distances(tmp_path):
    source, library = tmp_path / "on_cpu.cpp", tmp_path / "on_cpu.so"
    source.write_text(ON_CPU.replace("KERNELS", str(GPU / "kernels.cu")))
    command = ["g++", "-O1", "-w", "-shared", "-fPIC", "-o", library, source]
    subprocess.run(command, check=True)
    kernels = ctypes.CDLL(str(library))

    def address(tensor: torch.Tensor) -> ctypes.c_void_p:
        return ctypes.c_void_p(tensor.data_ptr())

    queries, points = torch.rand(2, 40, 3), torch.rand(2, 300, 3)
    found = torch.empty(2, 40, 8, dtype=torch.int64)
    kernels.each_knn(address(queries), address(points), address(found), 40, 300, 2)
    assert torch.equal(found, nearest_neighbours(queries, points, 8))

    mesh = mug()
    centre = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    x = np.random.default_rng(0).uniform(-0.08, 0.08, (400, 3)).astype(np.float32)
    triangles = torch.from_numpy((mesh.vertices - centre)[mesh.faces].astype(np.float32))
    distance = torch.empty(400)
    kernels.each_sdf(address(torch.from_numpy(x)), address(triangles), address(distance), 400,
                     len(triangles))  # fmt: skip
    truth = SignedDistance(mesh.vertices - centre, mesh.faces)(x)
    assert (truth < 0).any()
    assert np.abs(distance.numpy() - truth).max() < 1e-6


def test_embree_casts_the_same_rays_as_open3d(gpu, monkeypatch):
    pytest.importorskip("embreex", reason="pip install embreex")
    import rays

    from pointsdf_cli.camera import raycast
    from pointsdf_cli.camera.pinhole import CAMERAS

    mesh, pose = mug(), np.eye(4)
    pose[2, 3] = 0.5
    wanted = MeshCaster(mesh.vertices, mesh.faces, CAMERAS["xtion"]).cast_window(pose, 0.2)
    monkeypatch.setattr(raycast, "o3d", rays.stand_in())
    found = MeshCaster(mesh.vertices, mesh.faces, CAMERAS["xtion"]).cast_window(pose, 0.2)
    assert np.isfinite(wanted.depth).sum() > 1000
    np.testing.assert_allclose(found.depth, wanted.depth, atol=1e-6)
    np.testing.assert_allclose(found.cosine, wanted.cosine, atol=1e-4)


def test_a_batch_is_what_the_package_makes_of_the_view(gpu):
    """Same points, same evidence, same predictions, whether mirrored and turned or not."""
    import make_views
    from learn import RayWithSymmetry
    from views_on_device import Views

    mesh, rng = mug(), np.random.default_rng(1)
    drawer = SceneViews(mesh, make_views.COLOUR, SceneViewConfig(exact=1.0, exact_resting=1.0))
    view, _ = drawer.draw(rng)
    some = rng.choice(len(view.points), 1000, replace=False)
    view = type(view)(view.points[some], view.T_camera_object, view.evidence)
    row = make_views.view_arrays(view, rng) | {"object": np.array(0, np.int32)}
    labels = make_views.label_arrays(mesh, rng) | {"label_object": np.array(0, np.int32)}
    triangles = labels.pop("label_triangles")
    arrays = {name: value[None] for name, value in (row | labels).items()}
    file = {**arrays, "label_triangles": triangles, "label_faces": np.array([len(triangles)])}

    trained = load_model(WEIGHTS)
    views = Views(4, 2, torch.device("cpu"), trained.sideways)
    views._label(file)
    views.add_arrays([file])
    model = RayWithSymmetry(**trained.config())
    model.load_state_dict(trained.state_dict())
    model.eval()

    frame = network_frame(view.points)
    cloud = frame.to_network(view.points)
    camera = torch.from_numpy(-frame.centre[None] * frame.scale).float()
    around = surroundings_of([view.evidence], [frame], torch.device("cpu"))
    bare = surroundings_of([ViewEvidence()], [frame], torch.device("cpu"))
    with torch.no_grad():
        for evidence, known in ((True, around), (False, bare)):
            batch, symmetry = views.batch(torch.tensor([0]), 400, augment=False, evidence=evidence)
            kept = batch.cloud[0].numpy()
            assert KDTree(kept).query(cloud)[0].max() < 1e-3
            # In the batch's order: the first point decides which centres are farthest.
            wanted = trained.decode(trained.encode(batch.cloud, camera, None, known), batch.x)
            apart = (model.predict(batch, symmetry) - wanted).abs().flatten()
            # At an edge of the image a query may have other neighbours.
            assert float(apart.quantile(0.98)) < 1e-4
            turned, symmetry = views.batch(torch.tensor([0]), 400, augment=True, evidence=evidence)
            error = (model.predict(turned, symmetry) - turned.sdf).abs().median()
            plain = (wanted - batch.sdf).abs().median()
            assert float(error) < 3 * float(plain) + 0.01


def test_large_clouds_are_drawn_from_views_that_have_the_points(gpu):
    from make_views import MOST_POINTS
    from views_on_device import Views

    make = np.random.default_rng(3)
    views = Views(8, 2, torch.device("cpu"), 0.001, (1000, 2000, 3000))
    counts = np.array([400, 1500, 3000, 2200, 2999], np.int32)
    rows = {
        "points": make.normal(size=(5, MOST_POINTS, 3)).astype(np.float16),
        "count": counts,
        "object": np.zeros(5, np.int32),
        "camera": np.tile(np.array([0, 0, -9.0], np.float32), (5, 1)),
    }
    views._is_labelled[0] = True
    views.add_arrays([rows])
    views.refresh()
    parts = {size: views.of_size(size).tolist() for size in views.sizes}
    assert parts == {1000: [0, 1], 2000: [3, 4], 3000: [2]}
    assert set(views.draw(300, 1000).tolist()) == {0, 1, 2, 3, 4}
    assert set(views.draw(300, 2000).tolist()) == {2, 3, 4}
    cloud = views._sample(views.draw(2, 3000), 3000)
    assert len(torch.unique(cloud[0], dim=0)) > 2900  # none of them twice, but for rounding


def test_clouds_made_with_a_view_are_those_that_a_step_would_make(gpu):
    from make_views import MOST_POINTS, sampled
    from views_on_device import Views, _first_layer

    make = np.random.default_rng(4)
    counts = np.array([150, 1500, 3000], np.int32)
    points = make.normal(size=(3, MOST_POINTS, 3)).astype(np.float16)
    parts = [
        {"points": points[k], "count": counts[k], "object": np.int32(0),
         "camera": np.array([0, 0, -9.0], np.float32)} for k in range(3)
    ]  # fmt: skip
    rows = [part | sampled(part, 2, make) for part in parts]
    views = Views(4, 2, torch.device("cpu"), 0.001, (1000, 3000), samplings=2)
    views._is_labelled[0] = True
    views.add_arrays([{name: np.stack([row[name] for row in rows]) for name in rows[0]}])
    for number, size in ((0, 1000), (1, 1000), (2, 3000)):
        cloud, neighbours = views._clouds(torch.tensor([number]), size)
        own = torch.from_numpy(points[number, : counts[number]].astype(np.float32))
        assert set(map(tuple, cloud[0].tolist())) <= set(map(tuple, own.tolist()))
        assert len(torch.unique(cloud[0], dim=0)) >= 0.9 * min(size, counts[number])
        if counts[number] >= size:
            again, nearest = _first_layer(cloud)
            assert torch.equal(again, cloud)
            assert torch.equal(nearest, neighbours)


def test_a_short_run_writes_a_checkpoint(tmp_path):
    make = [sys.executable, GPU / "make_views.py", tmp_path / "views", "--objects", "8",
            "--validation", "2", "--views", "2", "--group", "2", "--workers", "1",
            "--files", "4", "--samplings", "1"]  # fmt: skip
    subprocess.run(make, check=True)
    assert (tmp_path / "views" / "000000.npz").is_file()
    learn = [sys.executable, GPU / "learn.py", tmp_path / "views", tmp_path / "out", "--device",
             "cpu", "--minutes", "0.03", "--batch-size", "4", "--first-views", "4",
             "--capacity", "500"]  # fmt: skip
    subprocess.run(learn, check=True)
    learned = load_model(tmp_path / "out").config()
    assert learned == load_model(WEIGHTS).config() | {"most_points": 3000}
    data = read_config(tmp_path / "out")["data"]
    assert (data["seed"], data["objects"], data["scans"]) == (1000, 8, 0)

    again = subprocess.run(learn, capture_output=True, text=True, check=False)
    assert (again.returncode, "holds a checkpoint already" in again.stderr) == (2, True)
    learn[3:] = [tmp_path / "few", *learn[4:], "--first-views", "400"]
    few = subprocess.run(learn, capture_output=True, text=True, check=False)
    assert few.returncode == 2
    assert "no more are made" in few.stderr
    sizes = subprocess.run(
        [*learn, "--points", "1500"], capture_output=True, text=True, check=False
    )
    assert (sizes.returncode, "--points" in sizes.stderr) == (2, True)
    learn[2] = tmp_path / "viwes"
    with subprocess.Popen(["timeout", "100", *learn], stdout=subprocess.PIPE, text=True) as waiting:
        assert waiting.stdout is not None
        assert str(learn[2]) in waiting.stdout.readline()
        waiting.terminate()


def test_only_better_finite_weights_replace_a_checkpoint(tmp_path, gpu, monkeypatch):
    import learn

    losses = iter((0.3, 0.2, 0.25, float("nan")))
    weights = (torch.full((2,), float(k)) for k in range(9))
    run = object.__new__(learn.Run)
    run._options = argparse.Namespace(start_from=None, out=tmp_path / "out", views=tmp_path)
    run._began, run._best, run._held_out, run._views = 0.0, None, None, SimpleNamespace(count=1)
    run._training = SimpleNamespace(
        validate=lambda _: {"object_loss": next(losses)},
        steps=7,
        config=TrainConfig(),
        model=SimpleNamespace(architecture="pointsdf-ray", config=dict),
        average=SimpleNamespace(weights=lambda: {"w": next(weights)}),
    )
    for kept in (0.3, 0.2, 0.2):
        run._save()
        assert read_config(tmp_path / "out")["best"]["object_loss"] == kept
    with pytest.raises(RgraspError, match="nan"):
        run._save()
    assert read_checkpoint(tmp_path / "out").weights["w"].tolist() == [1.0, 1.0]


def test_the_held_out_objects_cannot_be_trained_on(tmp_path, gpu, monkeypatch, capsys):
    import make_views

    monkeypatch.setattr(sys, "argv", ["make_views.py", str(tmp_path), "--seed", "62"])
    with pytest.raises(SystemExit) as left:
        make_views.main()
    assert (left.value.code, "held-out" in capsys.readouterr().err) == (2, True)


def one_box(folder: Path) -> argparse.Namespace:
    """Options of make_views.py for one scan."""
    trimesh.creation.box((0.04, 0.06, 0.1)).export(folder / "box.ply")
    return argparse.Namespace(
        validation=0, seed=5, objects=3, meshes=folder, group=100, views=1, exact=1.0,
        spread=0.0, dark=0.0, strips=0.0, samplings=0, out=folder / "out",
    )  # fmt: skip


def test_views_of_other_options_or_scans_are_not_used_again(tmp_path, gpu):
    import make_views

    options = one_box(tmp_path)
    for _ in range(2):
        make_views.write_recipe(options)
    trimesh.creation.icosphere(radius=0.03).export(tmp_path / "box.ply")  # as many, of its name
    with pytest.raises(InputError, match="scans_sha256"):
        make_views.write_recipe(options)
    options.meshes, options.group = None, 12
    with pytest.raises(InputError, match="group, scans, scans_sha256"):
        make_views.write_recipe(options)


def test_a_scan_becomes_several_objects(tmp_path, gpu):
    import make_views

    options = one_box(tmp_path)
    first = next(make_views.tasks(options))
    scans = sorted((one for one in first.sources if one.path), key=lambda one: one.number)
    assert [one.number for one in scans] == list(range(3, 3 + make_views.SCAN_SHAPES))
    sizes = np.array([np.ptp(one.mesh().vertices, axis=0) for one in scans])
    np.testing.assert_allclose(sizes[0], [0.04, 0.06, 0.1], atol=1e-6)
    stretched = np.log(sizes[1:] / sizes[0])
    assert stretched.std() == pytest.approx(make_views.STRETCH, rel=0.4)
    assert (np.ptp(stretched, axis=1) > 0.01).all()  # not the same along each axis


def test_training_ends_where_its_views_end(tmp_path: Path) -> None:
    """A folder of meshes that is not there ends the making of views."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    ran = subprocess.run(
        ["bash", GPU / "train.sh", tmp_path / "work", tmp_path / "nowhere"],
        env=os.environ | {"PATH": path, "DEVICE": "cpu", "MINUTES": "0.05"},
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert ran.returncode == 1
    assert "make_views.py ended" in ran.stderr
    assert "no such folder" in ran.stderr
    assert "nowhere" in (tmp_path / "work" / "views.log").read_text()
