"""`rgrasp serve`: real plans over HTTP, equal to those of the command, and refusals."""

from __future__ import annotations

import asyncio
import io
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import trimesh
from doc_blocks import blocks
from starlette.requests import ClientDisconnect
from test_cli_mesh import constant_network

from pointsdf_cli.assets import asset_path
from pointsdf_cli.errors import InputError
from pointsdf_cli.io.clouds import Cloud, DepthImage, read_cloud, write_cloud
from pointsdf_cli.io.hdf5 import read_artifact
from pointsdf_cli.io.meshes import closed_body
from pointsdf_cli.io.plans import read_plan
from pointsdf_cli.io.trees import tree_of_npz, tree_to_npz
from pointsdf_cli.planning.cancellation import CancelledError, stop_if_cancelled
from pointsdf_cli.planning.environment import Environment, Obstacle
from pointsdf_cli.planning.mesh_choices import MeshChoices
from pointsdf_cli.planning.object_choice import TargetChoice
from pointsdf_cli.planning.object_view import bare_cloud
from pointsdf_cli.planning.plan_request import PlanChoices, PlanRequest
from pointsdf_cli.service.client import request_tree
from pointsdf_cli.service.request_queue import BusyError, ClosingError, RequestQueue

pytest.importorskip("fastapi", reason="the extra `serve` is not installed")
pytest.importorskip("uvicorn", reason="the extra `serve` is not installed")

from pointsdf_cli.models.registry import use_threads
from pointsdf_cli.service.app import Gate, _unless
from pointsdf_cli.service.bodies import PlanBody, read_body
from pointsdf_cli.service.identity import PlannerFiles
from pointsdf_cli.service.resident import Resident
from pointsdf_cli.service.server import Server

ROOT = Path(__file__).parent.parent
TABLE, MUG = asset_path("clouds/table.ply"), asset_path("clouds/mug.ply")
DRILL = asset_path("clouds/power_drill.ply")


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    use_threads(1)
    with Server(Resident(), places=2, largest=4 << 20) as running:
        yield running


def cloud_body(path: Path, **more: object) -> dict[str, object]:
    cloud = read_cloud(path)
    one = {
        "name": path.name,
        "points": cloud.points,
        "frame": cloud.frame,
        "T_world_camera": cloud.T_world_camera,
    }
    return {"clouds": [one], **more}


def post(server: Server, path: str, tree: object, **headers: str) -> httpx.Response:
    body = tree_to_npz(tree)
    given = {"Content-Type": "application/x-npz"} | headers
    return httpx.post(server.url + path, content=body, headers=given, timeout=120)


def test_a_served_plan_is_the_commands_to_the_bit(
    cli: Callable, server: Server, tmp_path: Path
) -> None:
    here, there = tmp_path / "here.h5", tmp_path / "there.h5"
    words = ("plan", TABLE, "--no-picture", "--min-success", "0.05")
    # Another plan comes between: what is kept of one must not show in the next.
    warm = post(server, "/plan", cloud_body(MUG, segment="none", min_success=0.05))
    assert warm.status_code == 200, warm.text
    served = cli(*words, "--out", there, "--server", server.url)
    own = cli(*words, "--out", here, "--threads", 1)
    assert (own.code, served.code) == (0, 0), own.err + served.err
    own_err, served_err = (re.sub(r"[\d.]+ s\b", "", err) for err in (own.err, served.err))
    assert own_err == served_err  # but for the seconds
    a, b = (read_artifact(path, schema="plan", version=1) for path in (here, there))
    assert sorted(a.datasets) == sorted(b.datasets)
    for name, values in a.datasets.items():
        assert values.dtype == b.datasets[name].dtype
        assert values.tobytes() == b.datasets[name].tobytes(), name
    timed = {"timings_json"}
    assert {k: v for k, v in a.attributes.items() if k not in timed} == {
        k: v for k, v in b.attributes.items() if k not in timed
    }
    # Two grasps of that very plan, and a hand on the other side of the room.
    plan = read_plan(there)
    astray = plan.q.copy()
    astray[0] += 2.0
    scored = post(server, "/score", cloud_body(TABLE, q=np.stack([plan.q, astray])))
    likely, unlikely = scored.json()["success_probability"]
    assert likely == pytest.approx(plan.success_probability, abs=1e-3)
    assert unlikely < likely
    refused = post(server, "/score", cloud_body(TABLE, q=plan.q[None], start=[0.0, 0.1]))
    assert refused.status_code == 400
    assert "start" in refused.text
    in_degrees = np.stack([plan.q, np.rad2deg(plan.q)])
    refused = post(server, "/score", cloud_body(TABLE, q=in_degrees))
    assert refused.status_code == 400
    assert "grasp 1: lbr4_joint_" in refused.text


def test_the_client_on_the_page_gets_a_plan(server: Server, tmp_path: Path) -> None:
    (example,) = (b for b in blocks(ROOT / "docs/serve.md") if b.language == "python")
    assert "http://127.0.0.1:8765" in example.text
    shutil.copy(TABLE, tmp_path / "cloud.ply")
    code = example.text.replace("http://127.0.0.1:8765", server.url)
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.startswith("ok [")


def test_a_request_arrives_as_it_was_sent() -> None:
    """Every field of a cloud that planning reads, and every option."""
    rng = np.random.default_rng(0)
    cloud = Cloud(
        rng.normal(size=(60, 3)) * 0.05 + [0, 0, 1],
        T_world_camera=np.eye(4),
        pixels=rng.integers(0, 4, (60, 2)).astype(float),
        image=DepthImage(rng.uniform(0.5, 1, (4, 5)), np.diag([600.0, 610.0, 1.0])),
        mask=rng.random(60) < 0.5,
        mask_rays=rng.normal(size=(7, 2)),
        over_table=True,
    )
    unread = {"normals", "colours", "notes"}
    plain = Cloud(cloud.points)
    for name in vars(cloud).keys() - unread - {"points", "frame"}:
        assert getattr(cloud, name) is not getattr(plain, name), f"{name} is not tried"
    block = trimesh.creation.box([0.1, 0.2, 0.3])
    closed = closed_body(np.asarray(block.vertices), block.faces, "block")  # as files are read
    obstacles = (
        Obstacle("post", "cylinder", (0.05, 0.4), np.eye(4)),
        Obstacle("block", "mesh", (), np.eye(4), *closed),
    )
    sent = PlanRequest(
        [cloud],
        ["a"],
        PlanChoices(kind="side", margin=0.002, speed=0.1, min_success=0.2),
        Environment(obstacles, table=False),
        np.arange(23.0),
        7,
        "auto",
        TargetChoice(pixel=(2.0, 3.0)),
        False,
        ((0.1, -0.5, 0.0), (1.0, 0.5, 0.4)),
        False,
        "hull",
    )
    body = tree_to_npz(request_tree(sent))
    back = read_body(PlanBody, body, "application/x-npz").request()
    np.testing.assert_equal(asdict(back), asdict(sent))


def test_no_plan_has_the_same_message_and_code(
    cli: Callable, server: Server, tmp_path: Path
) -> None:
    scene = read_cloud(TABLE)
    few = Cloud(scene.points[:60], frame=scene.frame, T_world_camera=scene.T_world_camera)
    write_cloud(tmp_path / "bare.ply", few)
    words = ("plan", tmp_path / "bare.ply", "--no-picture", "--force", "--out", tmp_path / "p.h5")
    own, served = cli(*words, "--threads", 1), cli(*words, "--server", server.url)
    assert own.code == served.code == 3
    assert own.err == served.err
    assert read_plan(tmp_path / "p.h5").reason == "no_object"


def test_a_refused_cloud_has_the_same_message(server: Server, cli: Callable) -> None:
    moved = read_cloud(TABLE)
    assert moved.T_world_camera is not None
    pose = moved.T_world_camera.copy()
    pose[2, 3] += 0.5  # the table half a metre above z = 0
    numbers = ",".join(map(str, pose[:3, 3]))
    body = cloud_body(TABLE)
    body["clouds"][0] |= {"T_world_camera": pose, "name": str(TABLE)}  # type: ignore[index]
    answer = post(server, "/plan", body)
    assert answer.status_code == 400, numbers
    assert answer.json()["error"]["exit_code"] == 2
    assert "z = 0" in answer.json()["error"]["message"]


def test_a_mesh_is_closed_and_where_the_cloud_is(server: Server) -> None:
    cloud = read_cloud(MUG)
    answer = post(server, "/mesh", cloud_body(MUG, resolution=32), Accept="application/x-npz")
    assert answer.status_code == 200, answer.text
    made = tree_of_npz(answer.content, "answer")
    mesh = trimesh.Trimesh(made["vertices"], made["faces"])
    assert mesh.is_watertight
    assert not made["warnings"]
    far = np.linalg.norm(mesh.vertices.mean(axis=0) - cloud.points.mean(axis=0))
    assert far < 0.1


def test_a_mesh_takes_the_robots_configuration(server: Server) -> None:
    asked = cloud_body(TABLE, resolution=32, segment="auto", start=[0.0, 9.0])
    answer = post(server, "/mesh", asked)
    assert answer.status_code == 400
    assert "--start" in answer.json()["error"]["message"]
    answer = post(server, "/mesh", asked | {"segment": "none"})
    assert answer.status_code == 400
    assert "segment: auto" in answer.json()["error"]["message"]


# Two triangles in a plane: a hull of them ends the process in a collision library.
FLAT = {
    "name": "sheet",
    "kind": "mesh",
    "pose": np.eye(4),
    "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]],
    "faces": [[0, 1, 2], [1, 3, 2]],
}


@pytest.mark.parametrize(
    ("tree", "words"),
    [
        ({}, "clouds"),
        ({"clouds": []}, "clouds"),
        ({"clouds": [{"points": [[1, 2]]}]}, "[N, 3]"),
        ({"clouds": [{"points": "many"}]}, "not numbers"),
        ({"clouds": [{"points": [[0, 0, 1]] * 9}]}, "the camera's pose is not known"),
        ({"clouds": [{"points": [[0, 0, 1]], "pose": 3}]}, "pose"),
        ({"clouds": [{"points": [[0, 0, 1]], "depth": [[1]], "K": np.zeros((3, 3))}]}, "focal"),
        ({**cloud_body(MUG), "method": "guess"}, "reconstruction, partial-view"),
        ({**cloud_body(MUG), "margin": -1}, "--margin"),
        ({**cloud_body(MUG), "target": [1, 2, 3, 4]}, "target"),
        ({**cloud_body(MUG), "expects": {"robot": "another"}}, "another robot"),
        ({**cloud_body(MUG), "start": [0.1, 0.2]}, "joint positions"),
        ({**cloud_body(MUG), "environment": {"obstacles": [FLAT]}}, "encloses no volume"),
        ({**cloud_body(MUG), "environment": {"obstacles": [{**FLAT, "faces": []}]}}, "faces"),
        ({"clouds": [{"points": [[0, 0, 1]], "mask": [0]}]}, "0 everywhere"),
    ],
)
def test_a_bad_body_is_told_and_harms_nothing(server: Server, tree: object, words: str) -> None:
    answer = post(server, "/plan", tree)
    assert answer.status_code == 400, answer.text
    assert words in answer.json()["error"]["message"]
    health = httpx.get(server.url + "/health").json()
    assert (health["status"], health["waiting"]) == ("ok", 0)


def test_an_empty_reconstruction_is_no_failure_of_the_server(tmp_path: Path) -> None:
    files = PlannerFiles(checkpoint=constant_network(tmp_path, 0.1))
    with Server(Resident(files)) as empty:
        answer = post(empty, "/mesh", cloud_body(DRILL, resolution=32))
        assert answer.status_code == 422
        assert "nothing solid" in answer.json()["error"]["message"]
        # Options are told before the request waits for its turn.
        wrong = post(empty, "/mesh", cloud_body(DRILL, resolution=77))
        assert (wrong.status_code, "--resolution" in wrong.text) == (400, True)


def test_weights_that_change_under_a_server_are_refused(tmp_path: Path) -> None:
    served = Resident(PlannerFiles(checkpoint=constant_network(tmp_path / "net", 0.1)))
    loaded = served.identity()
    first = served.planner(PlanChoices())
    constant_network(tmp_path / "net", -0.1)  # trained again, meanwhile
    assert served.identity() == loaded
    assert served.planner(PlanChoices()) is first
    with pytest.raises(InputError, match="have changed"):
        served.planner(PlanChoices(kind="top"))


def test_a_robot_that_changes_under_a_server_is_refused(tmp_path: Path) -> None:
    for name in ("panda.yaml", "panda.urdf"):
        shutil.copy(asset_path(f"robots/{name}"), tmp_path)
    served = Resident(PlannerFiles(robot=tmp_path / "panda.yaml"))
    served.identity()
    text = (tmp_path / "panda.yaml").read_text()
    (tmp_path / "panda.yaml").write_text(text + "# moved\n")
    with pytest.raises(InputError, match="have changed"):
        served.planner(PlanChoices())


def test_weights_that_change_before_the_first_mesh_are_refused(tmp_path: Path) -> None:
    served = Resident(PlannerFiles(checkpoint=constant_network(tmp_path / "net", 0.1)))
    served.identity()
    constant_network(tmp_path / "net", -0.1)
    with pytest.raises(InputError, match="have changed"):
        served.mesh(bare_cloud(read_cloud(MUG), "mug"), MeshChoices(), "mug")


def test_nobody_waits_for_a_client_that_left() -> None:
    async def left() -> bool:
        return True

    async def ask() -> None:
        await _unless(left, asyncio.sleep(60))

    began = time.monotonic()
    with pytest.raises(ClientDisconnect):
        asyncio.run(ask())
    assert time.monotonic() - began < 20


def test_what_is_no_npz_or_json_or_too_large_is_refused(server: Server) -> None:
    squeezed = io.BytesIO()
    np.savez_compressed(squeezed, tree=np.zeros(1 << 22, np.uint8))
    claims = tree_to_npz({"clouds": np.zeros((4, 3))}).replace(b"(4, 3)", b"(9**9)"[:6])
    for body in (b"", b"PK\x03\x04", os.urandom(900), squeezed.getvalue(), claims):
        answer = httpx.post(
            server.url + "/plan", content=body, headers={"Content-Type": "application/x-npz"}
        )
        assert answer.status_code == 400
    assert httpx.post(server.url + "/plan", content=b"[" * 99_999).status_code == 400
    assert httpx.post(server.url + "/plan", content=b"{}\xff").status_code == 400
    large = httpx.post(server.url + "/plan", content=b" " * (5 << 20))
    assert large.status_code == 413
    assert "4 MiB" in large.json()["error"]["message"]

    def pieces() -> Iterator[bytes]:  # without a length that could be looked at
        for _ in range(5):
            yield b" " * (1 << 20)

    with suppress(httpx.WriteError):  # it may hang up before all was sent
        assert httpx.post(server.url + "/plan", content=pieces()).status_code == 413
    assert httpx.get(server.url + "/health").json()["waiting"] == 0


def test_the_page_of_the_interface_needs_no_internet(server: Server, page: Any) -> None:
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(server.url + "/docs")
    page.wait_for_selector("#operations-default-_plan, [id$=plan_plan_post]", timeout=60_000)
    assert "/mesh" in page.inner_text("body")
    assert all(url.startswith((server.url, "data:")) for url in asked), asked


def test_pages_of_others_are_refused(server: Server) -> None:
    for headers in ({"Origin": "http://elsewhere.example"}, {"Host": "elsewhere.example"}):
        assert httpx.get(server.url + "/health", headers=headers).status_code == 403
    schema = httpx.get(server.url + "/openapi.json").json()
    assert {"/plan", "/mesh", "/score", "/health"} <= set(schema["paths"])
    referred = set(_references(schema))
    assert "#/components/schemas/CloudBody" in referred
    known = {f"#/components/schemas/{name}" for name in schema["components"]["schemas"]}
    assert referred <= known


def _references(node: object) -> Iterator[str]:
    if isinstance(node, dict):
        yield from (str(v) for k, v in node.items() if k == "$ref")
    for value in (
        node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    ):
        yield from _references(value)


def test_a_token_is_asked_for(cli: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    with Server(Resident(), token="open-sesame") as guarded:
        assert httpx.get(guarded.url + "/health").status_code == 200
        for headers in ({}, {"Authorization": "Bearer guess"}, {"Authorization": "open-sesame"}):
            for path in ("/plan", "/docs", "/openapi.json"):
                assert httpx.get(guarded.url + path, headers=headers).status_code == 401
        right = {"Authorization": "Bearer open-sesame"}
        assert httpx.get(guarded.url + "/openapi.json", headers=right).status_code == 200
        monkeypatch.setenv("RGRASP_TOKEN", "pässwort")
        run = cli("plan", TABLE, "--no-picture", "--server", guarded.url)
        assert run.code == 2
        assert "printable ASCII" in run.err
        monkeypatch.delenv("RGRASP_TOKEN")
        run = cli("plan", TABLE, "--no-picture", "--server", guarded.url)
        assert run.code == 2
        assert "RGRASP_TOKEN" in run.err


def test_a_defect_is_answered_in_the_form_of_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken(Resident):
        def mesh(self, *_: object, **__: object) -> None:
            raise ZeroDivisionError

    with Server(Broken()) as running:
        found = post(running, "/mesh", cloud_body(TABLE))
    assert found.status_code == 500
    assert found.json()["error"]["what"] == "the server failed; its terminal says why"


def test_one_works_the_next_wait_and_more_are_refused() -> None:
    queue, go = RequestQueue(places=1), threading.Event()
    first, second = queue.take_place(), queue.take_place()
    running = queue.submit(first, lambda: go.wait(10))
    with pytest.raises(BusyError):
        queue.take_place()
    waiting = queue.submit(second, lambda: "second")
    queue.leave(second)  # its client hung up: the place is free at once, the work never begun
    third = queue.submit(queue.take_place(), lambda: "third")
    go.set()
    assert (running.result(10), third.result(10)) == (True, "third")
    with pytest.raises(CancelledError):
        waiting.result(1)
    with pytest.raises(ZeroDivisionError):
        queue.submit(queue.take_place(), lambda: 1 // 0).result(10)
    queue.close()
    with pytest.raises(ClosingError):
        queue.take_place()
    queue.join()


def test_memory_is_returned_after_each_job_even_one_that_fails() -> None:
    returned = threading.Semaphore(0)
    queue = RequestQueue(after=returned.release)
    answer = queue.submit(queue.take_place(), lambda: 3)
    assert answer.result(5) == 3
    assert returned.acquire(timeout=5)
    failed = queue.submit(queue.take_place(), lambda: 1 // 0)
    assert isinstance(failed.exception(5), ZeroDivisionError)
    assert returned.acquire(timeout=5)
    queue.close()
    queue.join()


def test_work_that_nobody_waits_for_is_stopped() -> None:
    queue, begun = RequestQueue(places=1), threading.Event()

    def endless() -> None:
        begun.set()
        while True:
            stop_if_cancelled()
            time.sleep(0.001)

    job = queue.take_place()
    running = queue.submit(job, endless)
    assert begun.wait(10)
    queue.leave(job)
    with pytest.raises(CancelledError):
        running.result(10)
    queue.close()
    queue.join()


def test_closing_finishes_what_runs_and_tells_those_that_wait() -> None:
    queue, go, begun = RequestQueue(places=3), threading.Event(), threading.Event()
    running = queue.submit(queue.take_place(), lambda: (begun.set(), go.wait(10)))
    assert begun.wait(10)
    waiting = queue.submit(queue.take_place(), lambda: "never")
    late = queue.take_place()
    queue.close()
    with pytest.raises(ClosingError):
        waiting.result(1)
    with pytest.raises(ClosingError):
        queue.submit(late, lambda: "never").result(1)
    go.set()
    assert running.result(10)[1]
    queue.join()


def test_a_client_that_hangs_up_frees_its_place(server: Server) -> None:
    body = tree_to_npz(cloud_body(TABLE))
    head = (
        f"POST /plan HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nContent-Length: {len(body)}\r\n"
        "Content-Type: application/x-npz\r\n\r\n"
    ).encode()
    done = server.queue.done
    crowd = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(3)]
    for line in crowd:
        line.sendall(head + body)
    until(lambda: server.queue.waiting == 3)
    refused = post(server, "/plan", cloud_body(TABLE))
    assert refused.status_code == 429
    assert refused.headers["retry-after"]
    for line in crowd:
        line.close()
    until(lambda: server.queue.waiting == 0)
    # The one that ran was stopped or finished; those that waited were never begun.
    assert server.queue.done - done <= 1


def until(holds: Callable[[], bool], seconds: float = 20) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--host", "0.0.0.0"], "RGRASP_TOKEN"),
        (["--port", "70000"], "--port"),
        (["--queue", "-1"], "--queue"),
        (["--robot", "none.yaml"], "no such robot file"),
        (["--checkpoint", "none"], "none"),
        (["--device", "abacus"], "--device"),
    ],
)
def test_serve_refuses_bad_options(
    cli: Callable, monkeypatch: pytest.MonkeyPatch, words: list[str], told: str
) -> None:
    monkeypatch.delenv("RGRASP_TOKEN", raising=False)
    run = cli("serve", *words)
    assert run.code == 2
    assert told in run.err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--server", "127.0.0.1:80"], "not a server's address"),
        (["--server", "http://127.0.0.1:8765", "--threads", "2"], "--threads"),
        (["--server", "http://127.0.0.1:8765/plan"], "not a server's address"),
    ],
)
def test_plan_refuses_what_no_server_could_do(
    cli: Callable, tmp_path: Path, words: list[str], told: str
) -> None:
    run = cli("plan", TABLE, "--out", tmp_path / "p.h5", "--no-picture", *words)
    assert run.code == 2
    assert told in run.err


def test_sigterm_ends_a_server_that_answered_what_ran(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "pointsdf_cli.cli.main", "serve", "--port", "0", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            url = json.loads(process.stdout.readline())["url"]
            answers: list[httpx.Response] = []

            def ask() -> None:
                body = tree_to_npz(cloud_body(MUG, segment="none"))
                headers = {"Content-Type": "application/x-npz", "Accept": "application/x-hdf5"}
                answers.append(httpx.post(url + "/plan", content=body, headers=headers, timeout=60))

            asking = threading.Thread(target=ask)
            asking.start()
            until(lambda: httpx.get(url + "/health").json()["waiting"] == 1)
            time.sleep(0.2)
            process.send_signal(signal.SIGTERM)
            asking.join(60)
            assert process.wait(30) == 0
        finally:
            process.kill()
    assert answers[0].status_code in (200, 503)
    if answers[0].status_code == 200:
        (tmp_path / "plan.h5").write_bytes(answers[0].content)
        assert read_plan(tmp_path / "plan.h5").joint_names


def test_a_second_origin_is_looked_at_too() -> None:
    own = [(b"host", b"127.0.0.1:8765"), (b"origin", b"http://127.0.0.1:8765")]
    gate = Gate(None, "127.0.0.1", None)  # type: ignore[arg-type]
    assert gate._refusal({"headers": own, "path": "/plan"}) is None
    both = [*own, (b"origin", b"http://evil.test")]
    refused = gate._refusal({"headers": both, "path": "/plan"})
    assert refused is not None
    assert refused[0] == 403
