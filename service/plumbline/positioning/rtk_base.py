"""Which base, and what of it, an epoch of a rover is positioned against."""

from collections.abc import Mapping

import numpy as np

from plumbline.config import RtkSettings
from plumbline.epochs.base_book import BaseBook
from plumbline.gps_time import NS_PER_S
from plumbline.positioning.rtk_state import BaseView, no_base
from plumbline.records import Epoch


def _named(bases: Mapping[str, BaseBook], settings: RtkSettings) -> tuple[str, BaseBook | None]:
    """The stream that the settings name, else the only one there is."""
    if settings.base_stream is not None:
        return settings.base_stream, bases.get(settings.base_stream)
    if len(bases) == 1:
        return next(iter(bases.items()))
    return "", None


def due_until_ns(bases: Mapping[str, BaseBook], rover: Epoch, t_receive_ns: int, settings: RtkSettings) -> int | None:
    """Receive time as of which a rover's epoch is to be processed, or None while its base's epoch is waited for.

    At ``t_receive_ns`` everything received by then is in the books. The answer depends on receive times alone.
    """
    deadline_ns = rover.t_receive_ns + round(settings.base_wait_s * NS_PER_S)
    _, book = _named(bases, settings)
    if book is None or book.is_silent(rover.t_receive_ns) or not book.is_due(rover.t_gps_ns, rover.t_receive_ns):
        return rover.t_receive_ns
    if t_receive_ns >= deadline_ns or not book.is_due(rover.t_gps_ns, min(t_receive_ns, deadline_ns)):
        return deadline_ns
    return None


def base_view(bases: Mapping[str, BaseBook], t_gps_ns: int, as_of_receive_ns: int, settings: RtkSettings) -> BaseView:
    """What is known of the base at an instant; a setting for its position comes before the stream's own word."""
    name, book = _named(bases, settings)
    if book is None:
        if name:
            return no_base(name, f"no observations of base {name} yet")
        seen = ", ".join(sorted(bases)) or "none"
        return no_base("", f"no base stream is set, and the shared streams with observations are: {seen}")
    epoch = book.at(t_gps_ns, as_of_receive_ns)
    if epoch is None:
        return no_base(name, f"no observations of base {name} at or before this epoch")
    said = book.description(as_of_receive_ns)
    position = settings.base_position_ecef_m or (said.position_ecef_m if said else None)
    return BaseView(name, epoch, None if position is None else np.array(position))


def network_due_until_ns(
    bases: Mapping[str, BaseBook], rover: Epoch, t_receive_ns: int, settings: RtkSettings
) -> int | None:
    """As :func:`due_until_ns`, until no base is waited for any more."""
    latest_ns = rover.t_receive_ns
    for one in _each(bases, settings):
        due_ns = due_until_ns(bases, rover, t_receive_ns, one)
        if due_ns is None:
            return None
        latest_ns = max(latest_ns, due_ns)
    return latest_ns


def network_views(
    bases: Mapping[str, BaseBook], t_gps_ns: int, as_of_receive_ns: int, settings: RtkSettings
) -> list[BaseView]:
    """What is known of every base at an instant; their streams tell their positions."""
    return [base_view(bases, t_gps_ns, as_of_receive_ns, one) for one in _each(bases, settings)]


def _each(bases: Mapping[str, BaseBook], settings: RtkSettings) -> list[RtkSettings]:
    """The settings for each base alone; without any, for the lack of one."""
    names = settings.base_streams or tuple(sorted(bases))
    if not names:
        return [settings]
    return [settings.model_copy(update={"base_stream": name, "base_position_ecef_m": None}) for name in names]
