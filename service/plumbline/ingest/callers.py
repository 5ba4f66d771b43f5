"""Callers who were not let in: listed so that they can be adopted, and slowed down so that they do no harm.

Many devices share one address behind a carrier's gateway, so nothing here shuts an address out: what is slowed is the
pair of address and identity, and a device that is known is never refused for its neighbours' sake.
"""

from collections import Counter, OrderedDict
from dataclasses import dataclass, replace

from plumbline.gps_time import NS_PER_S

MAX_LISTED = 1000
BAD_TOKENS_BEFORE_PAUSE = 10
PAUSE_NS = 60 * NS_PER_S


@dataclass(frozen=True, slots=True)
class Caller:
    """A device that was refused: what it said, from where, when, how often, and why it was refused last."""

    identity: str  # its first bytes, printable; usable as a station's ``registrations``
    address: str
    first_seen_gps_ns: int
    last_seen_gps_ns: int
    attempts: int
    reason: str


class Callers:
    """The refused callers, the most recent last, at most ``MAX_LISTED``; and the refusals counted by reason."""

    def __init__(self) -> None:
        self._listed: OrderedDict[str, Caller] = OrderedDict()
        self._bad_tokens: OrderedDict[tuple[str, str], tuple[int, int]] = OrderedDict()
        self.refusals: Counter[str] = Counter()

    def refuse(self, identity: str, address: str, reason: str, t_gps_ns: int) -> Caller | None:
        """Note a refusal; the entry of the device, None for one that did not say who it is."""
        self.refusals[reason] += 1
        if reason == "bad_token":
            self._note_bad_token(identity, address, t_gps_ns)
        if not identity:
            return None
        known = self._listed.pop(identity, None) or Caller(identity, address, t_gps_ns, t_gps_ns, 0, reason)
        caller = replace(known, address=address, last_seen_gps_ns=t_gps_ns, attempts=known.attempts + 1, reason=reason)
        self._listed[identity] = caller
        if len(self._listed) > MAX_LISTED:
            self._listed.popitem(last=False)
        return caller

    def _note_bad_token(self, identity: str, address: str, t_gps_ns: int) -> None:
        n, _ = self._bad_tokens.pop((address, identity), (0, 0))
        self._bad_tokens[address, identity] = (n + 1, t_gps_ns)
        if len(self._bad_tokens) > MAX_LISTED:
            self._bad_tokens.popitem(last=False)

    def must_pause(self, identity: str, address: str, t_gps_ns: int) -> bool:
        """Whether an address has given too many wrong tokens for an identity within the last minute."""
        n, last_ns = self._bad_tokens.get((address, identity), (0, 0))
        if n and t_gps_ns - last_ns > PAUSE_NS:
            del self._bad_tokens[address, identity]
            return False
        return n >= BAD_TOKENS_BEFORE_PAUSE

    def forget(self, identity: str) -> None:
        """The device is known now."""
        self._listed.pop(identity, None)

    def listed(self) -> tuple[Caller, ...]:
        """Every listed caller, the most recent first."""
        return tuple(reversed(self._listed.values()))
