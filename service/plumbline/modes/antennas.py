"""A platform's antennas as instants, each with what its base, or bases, gave by then.

An instant waits for the antennas that are due, then for the base's epoch of the same instant; both for a while.
"""

from dataclasses import replace

from plumbline.config import Mode
from plumbline.gps_time import NS_PER_S
from plumbline.modes.context import Context
from plumbline.modes.instants import Instant, Instants
from plumbline.positioning.rtk_base import due_until_ns, network_due_until_ns


def due_instant(instants: Instants, context: Context, t_receive_ns: int) -> tuple[Instant, int] | None:
    """The next instant that waits no longer, which has left with this, and the receive time as of which to use it."""
    rtk = context.settings.rtk
    instant = instants.due(t_receive_ns, round(rtk.base_wait_s * NS_PER_S))
    if instant is None:
        return None
    network = context.settings.mode is Mode.RTK_NETWORK
    seen = replace(instant.first, t_receive_ns=instant.complete_ns)
    as_of_ns = (network_due_until_ns if network else due_until_ns)(context.books.bases, seen, t_receive_ns, rtk)
    if as_of_ns is None:
        return None
    instants.leave(instant)
    return instant, as_of_ns
