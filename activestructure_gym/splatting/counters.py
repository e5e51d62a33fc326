"""Provide atomic counters that distribute the work of a kernel over threads, and waiting between its parts."""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from activestructure_gym.splatting.memory import pointer_to
from activestructure_gym.splatting.simd import I64, inner

# Indices of counters. Counters 0 to 6 hand out work. Then: threads, stored alphas, units of work done per part, number
# of entries, and whether a thread has stopped waiting.
THREAD_TICKET, KEPT_TICKET, PROJECTED, PLANNED, FILLED, TILES_DONE, STEPPED, ENTRIES, GIVEN_UP, TICKETS = range(7, 17)
_PATIENCE = 1 << 19  # number of times a counter is read while waiting, about half a millisecond


@intrinsic
def take_ticket(typingctx, counters, index):
    """Add 1 to ``counters[index]`` atomically and return the previous value."""

    def codegen(context, builder, sig, args):
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        return builder.atomic_rmw("add", pointer, ir.Constant(I64, 1), "acq_rel")

    return types.int64(counters, types.intp), codegen


@intrinsic
def _read_ticket(typingctx, counters, index):
    """Read ``counters[index]`` atomically. Writes that other threads made before they increased it are visible."""

    def codegen(context, builder, sig, args):
        return builder.load_atomic(pointer_to(context, builder, sig.args[0], args[0], args[1]), "acquire", 8)

    return types.int64(counters, types.intp), codegen


@intrinsic
def take_tickets(typingctx, counters, index, count):
    """Add ``count`` to ``counters[index]`` atomically and return the previous value."""

    def codegen(context, builder, sig, args):
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        return builder.atomic_rmw("add", pointer, args[2], "monotonic")

    return types.int64(counters, types.intp, types.int64), codegen


@inner
def all_done(tickets, counter, units):
    """Wait until ``tickets[counter]`` reaches ``units``; return False if the calling thread must leave the kernel.

    A thread must leave after a long wait: another thread has work but no processor core, and leaving makes one free. It
    must also leave if any other thread has left. The counters of work are unchanged, so the kernel continues when it is
    called again.
    """
    for _ in range(_PATIENCE):
        if _read_ticket(tickets, counter) >= units:
            return _read_ticket(tickets, GIVEN_UP) == 0  # no thread continues if another one has left
    take_ticket(tickets, GIVEN_UP)
    return False
