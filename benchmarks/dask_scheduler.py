"""dask.distributed's pure scheduler state, driven without network or event loop, as a peer to compare with.

Independent tasks of one group through queued → processing → memory → forgotten, each finished as
soon as all of a round are assigned: what a test line asks of it, with less (no routes, no retests).
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

import logging
import time
from typing import Any

from dask._task_spec import Task
from distributed.collections import HeapSet
from distributed.core import Status
from distributed.scheduler import Computation, SchedulerState, WorkerState
from sortedcontainers import SortedDict


class _State(SchedulerState):
    """With room for the attributes that dask's Scheduler has and its SchedulerState forgets to name."""


def drive_dask(workers: int, tasks: int) -> float:
    """Tasks per CPU second with so many workers of one thread."""
    logging.getLogger("distributed.scheduler").setLevel(logging.WARNING)
    state = _State(
        aliases={},
        clients={},
        workers=SortedDict(),
        host_info={},
        resources={},
        tasks={},
        unrunnable={},
        queued=HeapSet(key=lambda ts: ts.priority),
        validate=False,
    )
    for number in range(workers):
        _add_worker(state, f"tcp://127.0.0.1:{number + 1}")
    computation = Computation()
    run_spec = Task("test", int)
    keys = [("test", number) for number in range(tasks)]
    for number, key in enumerate(keys):
        task = state.new_task(key, None, "released", computation)
        task.run_spec = run_spec
        task.priority = (0, 1, number)
    begun_s = time.process_time()
    _transitions(state, dict.fromkeys(keys, "waiting"))
    finished = 0
    while finished < tasks:
        running = [task for worker in state.workers.values() for task in tuple(worker.processing)]
        if not running:
            raise RuntimeError("dask assigns no more tasks: this driver does not fit its version")
        for task in running:
            _finish(state, task)
            finished += 1
    return tasks / (time.process_time() - begun_s)


def _add_worker(state: Any, address: str) -> None:
    worker = WorkerState(
        address=address,
        status=Status.running,
        pid=1,
        name=address,
        nthreads=1,
        memory_limit=2**33,
        local_directory="",
        nanny=None,
        server_id=address,
        scheduler=state,
    )
    state.workers[address] = worker
    state.running.add(worker)
    state.total_nthreads += 1
    state.check_idle_saturated(worker)
    state.idle_task_count.add(worker)


def _finish(state: Any, task: Any) -> None:
    now_s = time.time()
    recommendations, *_ = state._transition(
        task.key,
        "memory",
        "finished",
        worker=task.processing_on.address,
        nbytes=100,
        type=b"",
        typename="dict",
        startstops=[{"action": "compute", "start": now_s - 9.0, "stop": now_s}],
    )
    _transitions(state, recommendations)
    if state.queued and (free := state.idle_task_count):  # as Scheduler.stimulus_queue_slots_maybe_opened
        _transitions(state, {queued.key: "processing" for queued in state.queued.peekn(len(free))})


def _transitions(state: Any, recommendations: dict[Any, str]) -> None:
    state._transitions(recommendations, {}, {}, "bench")
