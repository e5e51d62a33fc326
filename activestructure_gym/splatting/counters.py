"""Atomic counters that hand out a kernel's work to its threads, and waits between its parts."""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from activestructure_gym.splatting.memory import pointer_to
from activestructure_gym.splatting.simd import I64, inner

# Counters: of work handed out (before these), of threads, of alphas kept, of work that is done; how many entries there
# are; whether somebody has given up waiting.
THREAD_TICKET, KEPT_TICKET, PROJECTED, PLANNED, FILLED, TILES_DONE, STEPPED, ENTRIES, GIVEN_UP, TICKETS = range(7, 17)
_PATIENCE = 1 << 19  # looks at a counter, about half a millisecond


@intrinsic
def take_ticket(typingctx, counters, index):
    """Atomic fetch-and-add of 1."""

    def codegen(context, builder, sig, args):
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        return builder.atomic_rmw("add", pointer, ir.Constant(I64, 1), "acq_rel")

    return types.int64(counters, types.intp), codegen


@intrinsic
def _read_ticket(typingctx, counters, index):
    """Atomic load; what was written before the counter was raised is there."""

    def codegen(context, builder, sig, args):
        return builder.load_atomic(pointer_to(context, builder, sig.args[0], args[0], args[1]), "acquire", 8)

    return types.int64(counters, types.intp), codegen


@intrinsic
def take_tickets(typingctx, counters, index, count):
    """Atomic fetch-and-add of ``count``."""

    def codegen(context, builder, sig, args):
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        return builder.atomic_rmw("add", pointer, args[2], "monotonic")

    return types.int64(counters, types.intp, types.int64), codegen


@inner
def all_done(tickets, counter, units):
    """Wait until so many units of work are done.

    False if that takes too long: then a thread that holds a unit has lost its core, and whoever waits leaves the kernel
    and so sets the other core free. Counters stay as they are: the kernel called again goes on from there.
    """
    for _ in range(_PATIENCE):
        if _read_ticket(tickets, counter) >= units:
            return _read_ticket(tickets, GIVEN_UP) == 0  # nobody goes on without those who have left
    take_ticket(tickets, GIVEN_UP)
    return False
