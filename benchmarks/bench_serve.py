"""Latency and memory of `rgrasp serve`: plans of a table asked by several clients at once.

python benchmarks/bench_serve.py [--requests 200] [--clients 4] [--threads 1]
python benchmarks/bench_serve.py --endless 1000    # memory every 100 plans of different seeds

Each client asks for its next plan when it has the last; a refusal (429) is waited out and asked
again. Printed are the median and the 95th percentile of a request from a client's side, how many
were lost, and the server's memory after the first and the last plan.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx
import numpy as np

from pointsdf_cli.assets import asset_path
from pointsdf_cli.io.clouds import read_cloud
from pointsdf_cli.io.trees import tree_to_npz


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--requests", type=int, default=200)
    parser.add_argument("--clients", type=int, default=4)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--endless", type=int, metavar="PLANS", help="One client, memory only.")
    options = parser.parse_args()
    command = [sys.executable, "-m", "pointsdf_cli.cli.main", "serve", "--port", "0", "--json"]
    command += ["--threads", str(options.threads)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = json.loads(process.stdout.readline())["url"]
            if options.endless:
                endless(url, process.pid, options.endless)
            else:
                measure(url, process.pid, options.requests, options.clients)
        finally:
            process.terminate()


def measure(url: str, process: int, requests: int, clients: int) -> None:
    """Ask and print."""
    bodies = table_bodies(10)
    alone = [asked(url, body) for body in bodies]  # the first loads what is loaded late
    print(f"one client, warm: request {np.median(alone[1:]):.2f} s median of {len(alone) - 1}")
    before = resident_megabytes(process)
    left, lock = list(range(requests)), threading.Lock()
    seconds: list[float] = []
    lost: list[str] = []

    def client() -> None:
        while True:
            with lock:
                if not left:
                    return
                turn = left.pop()
            try:
                answer = asked(url, bodies[turn % len(bodies)])
            except httpx.HTTPError as error:
                with lock:
                    lost.append(repr(error))
                continue
            with lock:
                seconds.append(answer)

    began = time.perf_counter()
    threads = [threading.Thread(target=client) for _ in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    wall = time.perf_counter() - began
    print(f"{len(seconds)} of {requests} answered, {len(lost)} lost, {wall:.0f} s")
    p50, p95 = np.percentile(seconds, [50, 95])
    print(f"request p50 {p50:.2f} s  p95 {p95:.2f} s")
    print(f"memory {before:.0f} MB before, {resident_megabytes(process):.0f} MB after")
    for error in lost[:5]:
        print(error)


def endless(url: str, process: int, plans: int, every: int = 100) -> None:
    """Ask one plan after another, each with a seed of its own, and print memory on the way."""
    bodies, seconds = table_bodies(plans), []
    for k, body in enumerate(bodies):
        seconds.append(asked(url, body))
        if k == 0 or (k + 1) % every == 0:
            recent = np.median(seconds[-every:])
            megabytes = resident_megabytes(process)
            print(f"plans {k + 1:5}  {megabytes:5.0f} MB  request {recent:.2f} s", flush=True)


def table_bodies(count: int) -> list[bytes]:
    """Requests for plans of the demo table, each with another seed."""
    cloud = read_cloud(asset_path("clouds/table.ply"))
    view = {"points": cloud.points, "frame": cloud.frame, "T_world_camera": cloud.T_world_camera}
    return [tree_to_npz({"clouds": [view], "seed": seed}) for seed in range(count)]


CLIENT = httpx.Client(timeout=600)
"""Made once: a client of its own for each request would load certificates for 25 ms."""


def asked(url: str, body: bytes) -> float:
    """Seconds of a request."""
    began = time.perf_counter()
    while True:
        headers = {"Content-Type": "application/x-npz"}
        answer = CLIENT.post(url + "/plan", content=body, headers=headers)
        if answer.status_code != 429:
            break
        time.sleep(float(answer.headers["retry-after"]))
    answer.raise_for_status()
    return time.perf_counter() - began


def resident_megabytes(process: int) -> float:
    """Resident memory of a process (Linux)."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return float(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1024


if __name__ == "__main__":
    main()
