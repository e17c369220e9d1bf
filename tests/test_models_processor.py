"""Parts side by side: the same answers in the same order, with the caller's settings."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import pytest
import torch
from threadpoolctl import threadpool_info, threadpool_limits
from torch import Tensor

from pointsdf_cli.models.processor import (
    ALIGNED,
    FEWEST,
    even_parts,
    in_steps,
    map_in_parallel,
    one_blas_thread,
    run_in_parallel,
    timed,
    use_threads,
)
from pointsdf_cli.planning.cancellation import CancelledError, cancellable, stop_if_cancelled

T = TypeVar("T")

PARTS = torch.arange(40.0).reshape(-1, 1).split(6)


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_every_part_is_answered_in_order_by_more_than_one_thread() -> None:
    threads, both = set(), threading.Barrier(2)

    def doubled(part: Tensor) -> Tensor:
        if len(threads) < 2:
            threads.add(threading.get_ident())
            both.wait(10)  # breaks if one thread does everything
        assert torch.get_num_threads() == 1
        return 2 * part

    answers = torch.cat(map_in_parallel(doubled, PARTS))
    assert torch.equal(answers.ravel(), 2 * torch.arange(40.0))
    assert torch.get_num_threads() == 2


@pytest.mark.parametrize("reduced", [False, True])
@pytest.mark.parametrize("gradients", [False, True])
def test_the_callers_autocast_and_gradient_mode_hold(reduced: bool, gradients: bool) -> None:
    weight = torch.ones(1, 1, requires_grad=True)
    with torch.set_grad_enabled(gradients), torch.autocast("cpu", torch.bfloat16, enabled=reduced):
        answers = map_in_parallel(lambda part: part @ weight, PARTS)
    assert {a.dtype for a in answers} == {torch.bfloat16 if reduced else torch.float32}
    assert {a.requires_grad for a in answers} == {gradients}


@pytest.mark.parametrize("who", ["caller", "helper"])
def test_an_error_in_a_part_is_the_callers_and_ends_the_work(who: str) -> None:
    here, both = threading.get_ident(), threading.Barrier(2)
    begun: list[int] = []

    def fails(part: Tensor) -> Tensor:
        begun.append(len(begun))
        if len(begun) <= 2:
            both.wait(10)  # each has a part
        if (threading.get_ident() == here) == (who == "caller"):
            raise ValueError("no")
        time.sleep(0.05)
        return part

    with pytest.raises(ValueError, match="no"):
        map_in_parallel(fails, torch.zeros(400, 1).split(1))
    assert len(begun) <= 3
    assert torch.get_num_threads() == 2


def test_helpers_are_in_inference_mode_too() -> None:
    with torch.inference_mode():
        answers = map_in_parallel(lambda part: part + 1, PARTS)
    assert all(answer.is_inference() for answer in answers)
    assert not any(
        answer.is_inference() for answer in map_in_parallel(lambda part: part + 1, PARTS)
    )


def test_the_calling_thread_works_too() -> None:
    here, seen, both = threading.get_ident(), set(), threading.Barrier(2)

    def where(part: Tensor) -> Tensor:
        if threading.get_ident() not in seen:
            seen.add(threading.get_ident())
            both.wait(10)
        return part

    map_in_parallel(where, PARTS)
    assert here in seen
    assert len(seen) == 2


def test_one_part_or_one_thread_stays_here() -> None:
    here = threading.get_ident()

    def where(part: Tensor) -> Tensor:
        assert threading.get_ident() == here
        assert torch.get_num_threads() == 1  # nobody waits for anybody inside an operation
        return part

    map_in_parallel(where, PARTS[:1])
    torch.set_num_threads(1)
    map_in_parallel(where, PARTS)


@pytest.mark.parametrize("count", [0, 1, 2 * FEWEST - 1, 2 * FEWEST, 4097, 8192, 20_001])
def test_threads_get_as_many_rows_each(count: int) -> None:
    rows = torch.arange(float(count)).reshape(-1, 1)
    parts = even_parts(rows, 4096)
    assert torch.equal(torch.cat(parts), rows)
    sizes = [len(part) for part in parts]
    assert max(sizes) <= 4096
    if count < 2 * FEWEST:
        assert len(parts) == 1  # not worth a second thread
    else:
        assert len(parts) % 2 == 0
        assert len(set(sizes[:-1])) == 1
        assert sizes[0] % ALIGNED == 0
        # As even as whole multiples allow: what the others are rounded up by, the last one lacks.
        assert 0 <= sizes[0] - sizes[-1] < len(parts) * ALIGNED


def test_one_thread_takes_few_parts() -> None:
    torch.set_num_threads(1)
    assert [len(part) for part in even_parts(torch.zeros(4096, 3), 4096)] == [4096]
    assert [len(part) for part in even_parts(torch.zeros(5000, 3), 4096)] == [2560, 2440]


def test_what_is_not_on_the_processor_is_not_cut_for_threads() -> None:
    rows = torch.zeros(5000, 3, device="meta")
    assert [len(part) for part in even_parts(rows, 4096)] == [4096, 904]


def test_rows_are_padded_to_steps() -> None:
    rows = torch.arange(10.0).reshape(5, 2)
    padded = in_steps(rows, 4)
    assert padded.shape == (8, 2)
    assert torch.equal(padded[:5], rows)
    assert torch.equal(padded[5:], rows[-1:].expand(3, 2))
    assert in_steps(rows, 5) is rows
    assert len(in_steps(rows[:0], 4)) == 0


def test_tasks_run_at_once_with_one_thread_each() -> None:
    both = threading.Barrier(2, timeout=20)  # passed only if both tasks run at a time

    def task(number: int) -> tuple[int, int]:
        both.wait()
        return number, torch.get_num_threads()

    assert run_in_parallel([lambda k=k: task(k) for k in range(2)]) == [(0, 1), (1, 1)]
    assert torch.get_num_threads() == 2


def test_a_tasks_error_is_the_callers_after_the_others_end() -> None:
    ended = []

    def late() -> None:
        time.sleep(0.05)
        ended.append(True)

    with pytest.raises(ZeroDivisionError):
        run_in_parallel([lambda: 1 // 0, late])
    assert ended


def test_tasks_see_that_their_caller_is_cancelled() -> None:
    with cancellable(lambda: True), pytest.raises(CancelledError):
        run_in_parallel([stop_if_cancelled, int])


def test_with_one_thread_tasks_run_here_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "get_num_threads", lambda: 1)
    here = threading.get_ident()
    assert run_in_parallel([threading.get_ident, threading.get_ident]) == [here, here]


def test_a_timed_task_gives_its_result_and_seconds() -> None:
    result, seconds = timed(divmod, 7, 2)
    assert result == (3, 1)
    assert 0 <= seconds < 1


def blas_threads() -> set[int]:
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


def test_numpy_gets_one_thread_whatever_pytorch_gets() -> None:
    before = torch.get_num_threads()
    try:
        use_threads(2)
        assert torch.get_num_threads() == 2
        assert blas_threads() == {1}
    finally:
        torch.set_num_threads(before)


def test_numpy_gets_its_threads_back() -> None:
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        with one_blas_thread():
            assert blas_threads() == {1}
        assert blas_threads() == before


def in_new_thread(task: Callable[[], T]) -> T:
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(task).result()


def test_a_limit_of_numpy_leaves_pytorchs_threads_as_they_are() -> None:
    # OpenMP's number is not PyTorch's yet in a thread that is new; it was kept as it was.
    torch.set_num_threads(1)

    def planned() -> int:
        with one_blas_thread():
            assert torch.get_num_threads() == 1
        return torch.get_num_threads()

    assert in_new_thread(planned) == 1


def openmp_threads() -> int:
    """OpenMP's number of threads in this thread, in PyTorch's library of it."""
    (found,) = {
        one["num_threads"]
        for one in threadpool_info()
        if one["user_api"] == "openmp" and "torch" in one["filepath"]
    }
    return int(found)


def test_openmp_has_one_thread_in_each_of_several() -> None:
    both = threading.Barrier(2)

    def counted(part: object = None) -> Tensor:
        both.wait(10)  # two threads, a part each
        return torch.tensor([openmp_threads()])

    assert [int(one) for one in run_in_parallel([counted, counted])] == [1, 1]
    assert [int(one) for one in map_in_parallel(counted, PARTS[:2])] == [1, 1]
