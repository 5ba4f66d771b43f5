"""Integers for the tight filter: which to believe, when to hold them, and when to let them go.

A wrong integer is a wrong displacement of centimetres that looks like the best solution there is. So integers are

- found with a covariance that knows what averaging does not remove: an arc's phase keeps its multipath for minutes, so
  the error of its float ambiguity never falls below that, however many epochs were averaged;
- believed when the bootstrapped success rate of that covariance, scaled up where the integers fit worse than it says,
  is what the settings ask for, and the second best is worse by the ratio asked for (with a success rate of 99.9 % a
  ratio test of fixed failure rate is passed by any: Verhagen & Teunissen 2013, J Geod 87:535-547);
- held when the filter, which carries position and attitude from epoch to epoch by the IMU, has found the same ones for
  a while; where not all can be resolved, the largest set that can;
- let go when a search that knows nothing of them, surer than theirs was, finds others twice.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from plumbline.config import RtkSettings
from plumbline.estimation.ambiguity import resolve
from plumbline.fusion.strapdown import ERROR_SIZE
from plumbline.fusion.tight_arcs import Pending, matched
from plumbline.fusion.tight_observations import ANTENNA_KEY, TightEpoch, base_share
from plumbline.gps_time import NS_PER_S
from plumbline.positioning.state import Records
from plumbline.records import Floats, Ints

_MEMORY_S: Final = 60.0  # how long a phase's multipath lasts
_MOST_SETS: Final = 6  # of ambiguities tried at an epoch
_CONFIRM_NS: Final = NS_PER_S  # integers wait so long, and so many epochs, for confirmation
_CONFIRM_EPOCHS: Final = 3
_WORST_FACTOR: Final = 9.0  # of variance: integers that fit worse than three sigma all together are none


@dataclass(frozen=True, slots=True)
class Found:
    """Integers to be believed at one epoch."""

    arc: Ints  # (k,) indices
    integer: Ints  # (k,)
    covariance: Floats  # (k, k) cycles², of the float values, lasting errors included


def find(p: Floats, arcs: Records, epoch: TightEpoch, rtk: RtkSettings, min_success_rate: float) -> Found | None:
    """The largest of nested sets of ambiguities that can be resolved, or None.

    Sets grow with the variance of what they add, so multipath near the horizon does not stand in the way of the rest.
    """
    states = np.flatnonzero(~arcs["held"])
    covariance = p[ERROR_SIZE:, ERROR_SIZE:] + lasting(arcs[states], epoch)
    wanted = np.flatnonzero(arcs["integer"][states])
    wanted = wanted[np.argsort(np.diag(covariance)[wanted], kind="stable")]
    for size in _set_sizes(wanted.size):
        chosen = np.sort(wanted[:size])
        q = covariance[np.ix_(chosen, chosen)]
        integers = _believed(arcs["value"][states[chosen]], q, rtk.min_ratio, min_success_rate)
        if integers is not None:
            return Found(states[chosen], integers, q)
    return None


def _believed(values: Floats, q: Floats, min_ratio: float, min_success_rate: float) -> Ints | None:
    """Integers of values (k,), or None; where they fit badly, with a covariance scaled to the fit."""
    found = resolve(values, q, min_ratio, min_success_rate, partial=False)
    if not found.complete:
        return None
    factor = found.squared_norm / values.size
    if factor > _WORST_FACTOR:
        return None
    if factor > 1.0 and not resolve(values, factor * q, min_ratio, min_success_rate, partial=False).complete:
        return None
    return found.integers


def wandered(p: Floats, arcs: Records, epoch: TightEpoch, interval_s: float) -> Floats:
    """Covariance after an interval in which the multipath of the phases has changed by a little.

    The state of an arc is its ambiguity and the error that lasts: its random walk's variance grows by ``2 σ²/τ`` a
    second. Taken for constant, a minute of phases would tell the position to centimetres by the satellites' motion.
    """
    states = arcs[~arcs["held"]]
    if not states.size:
        return p
    out, at = p.copy(), ERROR_SIZE + np.arange(states.size)
    out[at, at] += 2.0 * interval_s / _MEMORY_S * _sigma_cycles(states, epoch) ** 2
    return out


def _sigma_cycles(arcs: Records, epoch: TightEpoch) -> Floats:
    """Sigma (k,) of an arc's phase, cycles; one for arcs not seen now, which have little to tell."""
    order = np.argsort(epoch.key)
    at = matched(epoch.key[order], arcs["key"])
    seen, at = at >= 0, order[at]
    sigma: Floats = np.where(seen, np.sqrt(epoch.variance[at, 0]) / epoch.wavelength_m[at], 1.0)
    return sigma


def _set_sizes(n: int) -> list[int]:
    """Sizes of the sets tried, falling by a quarter."""
    sizes = []
    while n > 0:
        sizes.append(n)
        n = min(n - 1, (3 * n) // 4)
    return sizes[:_MOST_SETS]


def lasting(arcs: Records, epoch: TightEpoch) -> Floats:
    """Covariance (k, k), cycles², of what arcs' phases keep for minutes: their multipath, as large as a phase's sigma.

    Antennas share the base's part for a satellite; all of a group share their datum's.
    """
    sigma, link, group = _sigma_cycles(arcs, epoch), arcs["key"] % ANTENNA_KEY, arcs["group"]
    same_link, same_group = link[:, None] == link[None, :], group[:, None] == group[None, :]
    out: Floats = base_share() * np.outer(sigma, sigma) * same_link
    out[np.diag_indices_from(out)] = sigma**2
    datum = np.array([sigma[group == g].min() for g in group])
    out += same_group * np.outer(datum, datum)
    return out


def confirm(pending: Pending | None, found: Found | None, arcs: Records, t_gps_ns: int) -> Pending | None:
    """What waits for confirmation after this epoch: carried on where the integers are those of before, else begun."""
    if found is None:
        return None
    key, integer = arcs["key"][found.arc], found.integer.astype(np.int64)
    if pending is not None and np.array_equal(pending.key, key) and np.array_equal(pending.integer, integer):
        return replace(pending, count=pending.count + 1)
    return Pending(key, integer, t_gps_ns, 1)


def is_confirmed(pending: Pending | None, t_gps_ns: int) -> bool:
    """Whether integers have waited long enough."""
    if pending is None:
        return False
    return pending.count >= _CONFIRM_EPOCHS and t_gps_ns - pending.t_since_gps_ns >= _CONFIRM_NS


def conditioned(p: Floats, arcs: Records, found: Found) -> tuple[Floats, Floats, Records]:
    """The rest of the state given integers: its change (15,), its covariance, and the arcs, those held.

    The float values are measurements of the integers with the lasting errors as their noise: ``x += K (z − a)`` with
    ``K = P_xa (P_aa + L)⁻¹``, after which the ambiguities are marginalised.
    """
    at = ERROR_SIZE + np.searchsorted(np.flatnonzero(~arcs["held"]), found.arc)
    rest = np.setdiff1d(np.arange(p.shape[0]), at)
    gain = np.linalg.solve(found.covariance, p[np.ix_(at, rest)]).T
    moved = gain @ (found.integer - arcs["value"][found.arc])
    left = p[np.ix_(rest, rest)] - gain @ p[np.ix_(at, rest)]
    arcs = arcs.copy()
    arcs["value"][found.arc], arcs["held"][found.arc] = found.integer, True
    arcs["value"][~arcs["held"]] += moved[ERROR_SIZE:]
    return moved[:ERROR_SIZE], np.ascontiguousarray(0.5 * (left + left.T)), arcs


def speaks_against(found: Found | None, free: Records, held: Records) -> bool:
    """Whether integers found among ``free`` arcs are others than those held, up to a datum of each group."""
    if found is None:
        return False
    values = free["value"].copy()
    values[found.arc] = found.integer
    sure = free["held"].copy()  # the datums
    sure[found.arc] = True
    at = matched(held["key"], free["key"])
    known = sure & (at >= 0)
    known[known] = held["held"][at[known]]
    difference, group = values[known] - held["value"][at[known]], held["group"][at[known]]
    return any(np.ptp(difference[group == g]) != 0 for g in np.unique(group))
