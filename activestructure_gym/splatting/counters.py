"""Provide atomic counters that distribute a kernel's work over threads, and waits between its parts."""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from activestructure_gym.splatting.memory import pointer_to
from activestructure_gym.splatting.simd import I64, inner

# Counters: work handed out (before these), threads, alphas stored, work done, number of entries, and whether a thread
# has stopped waiting.
THREAD_TICKET, KEPT_TICKET, PROJECTED, PLANNED, FILLED, TILES_DONE, STEPPED, ENTRIES, GIVEN_UP, TICKETS = range(7, 17)
_PATIENCE = 1 << 19  # polls of a counter, about half a millisecond


@intrinsic
def take_ticket(typingctx, counters, index):
    """Add 1 atomically and return the previous value."""

    def codegen(context, builder, sig, args):
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        return builder.atomic_rmw("add", pointer, ir.Constant(I64, 1), "acq_rel")

    return types.int64(counters, types.intp), codegen


@intrinsic
def _read_ticket(typingctx, counters, index):
    """Load atomically; all writes made before the counter was raised are visible."""

    def codegen(context, builder, sig, args):
        return builder.load_atomic(pointer_to(context, builder, sig.args[0], args[0], args[1]), "acquire", 8)

    return types.int64(counters, types.intp), codegen


@intrinsic
def take_tickets(typingctx, counters, index, count):
    """Add ``count`` atomically and return the previous value."""

    def codegen(context, builder, sig, args):
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        return builder.atomic_rmw("add", pointer, args[2], "monotonic")

    return types.int64(counters, types.intp, types.int64), codegen


@inner
def all_done(tickets, counter, units):
    """Wait until ``units`` units of work are done; return False if the calling thread must leave the kernel.

    It must leave after a long wait: another thread holds a unit but has no core, and leaving frees one. It must also
    leave if any other thread has left. The counters of work are unchanged, so the kernel continues when called again.
    """
    for _ in range(_PATIENCE):
        if _read_ticket(tickets, counter) >= units:
            return _read_ticket(tickets, GIVEN_UP) == 0  # no thread continues without those that left
    take_ticket(tickets, GIVEN_UP)
    return False
