import os
import threading

import pytest

import activestructure_gym.compiling.thread_team as team_module
from activestructure_gym.compiling.thread_team import ThreadTeam, default_threads


def test_every_thread_calls_the_kernel_once():
    team, calls, together = ThreadTeam(), [], threading.Barrier(3, timeout=10)

    def kernel(value):
        together.wait()  # passes only if three threads are here at once
        calls.append((value, threading.get_ident()))

    for _ in range(3):
        team.run(kernel, ("a",), 3)
    assert len(calls) == 9
    assert len({thread for _, thread in calls}) == 3  # the workers stay


def _calls_of_two(team):
    calls, both = [], threading.Barrier(2, timeout=10)

    def kernel():
        both.wait()
        calls.append(1)

    team.run(kernel, (), 2)
    return len(calls)


def test_an_error_in_a_worker_reaches_the_caller_and_the_crew_stays_usable():
    team, caller, began = ThreadTeam(), threading.get_ident(), threading.Event()

    def fails_elsewhere():
        if threading.get_ident() == caller:
            began.wait(10)
        else:
            began.set()
            raise KeyError("in the worker")

    with pytest.raises(KeyError, match="in the worker"):
        team.run(fails_elsewhere, (), 2)
    assert _calls_of_two(team) == 2


def test_a_worker_that_has_not_woken_up_is_not_waited_for():
    team, late = ThreadTeam(), threading.Lock()
    assert _calls_of_two(team) == 2
    worker = team._workers[0]

    class NeverWakes:
        def acquire(self, blocking=True):
            return True

        def release(self):
            late.acquire(blocking=False)

    worker.start, start = NeverWakes(), worker.start
    calls = []
    team.run(lambda: calls.append(1), (), 2)  # would hang if it waited
    assert len(calls) == 1 and late.locked()
    worker.start = start
    assert _calls_of_two(team) == 2


def test_an_interrupt_while_waiting_does_not_reach_the_next_call():
    # A lock left held or released by Ctrl-C would let a later call return before its workers have finished.
    team = ThreadTeam()
    assert _calls_of_two(team) == 2
    worker = team._workers[0]

    class Interrupted:
        def acquire(self):
            raise KeyboardInterrupt

        def release(self):
            pass

    worker.done = Interrupted()
    with pytest.raises(KeyboardInterrupt):
        _calls_of_two(team)
    assert _calls_of_two(team) == 2 and worker not in team._workers


def test_a_second_caller_works_alone():
    team, inside, leave = ThreadTeam(), threading.Event(), threading.Event()

    def waits():
        inside.set()
        leave.wait(10)

    other = threading.Thread(target=team.run, args=(waits, (), 2))
    other.start()
    inside.wait(10)
    calls = []
    team.run(lambda: calls.append(1), (), 2)
    leave.set()
    other.join(10)
    assert len(calls) == 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_works_in_a_forked_child():
    team = ThreadTeam()
    assert _calls_of_two(team) == 2
    child = os.fork()
    if child == 0:
        os._exit(0 if _calls_of_two(team) == 2 else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_thread_count_follows_the_environment_and_the_load(monkeypatch):
    monkeypatch.setattr(os, "getloadavg", lambda: (0.0, 0.0, 0.0), raising=False)
    monkeypatch.setattr(team_module, "_crowded_until", (0.0, False))
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1, 2}, raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert default_threads() == 3
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    assert default_threads() == 2
    monkeypatch.setenv("OMP_NUM_THREADS", "100000")
    assert default_threads() == 3
    monkeypatch.setattr(os, "getloadavg", lambda: (1e4, 0.0, 0.0), raising=False)
    assert default_threads() == 3  # looked at most once a second
    monkeypatch.setattr(team_module, "_crowded_until", (0.0, False))
    assert default_threads() == 1
