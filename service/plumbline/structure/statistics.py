"""Least, greatest, mean and root mean square of motion, by component, in a form that summaries of parts join into
one.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from plumbline.errors import ContractError
from plumbline.records import Floats, Motion


@dataclass(frozen=True, slots=True)
class Summary:
    """Of samples (n, c), NaN left out; ``count`` and the rest are (c,), NaN where a component has no sample."""

    count: Floats
    minimum: Floats
    maximum: Floats
    mean: Floats
    rms: Floats  # about zero


def summary(values: Floats) -> Summary:
    """Summary of samples (n, c)."""
    known = ~np.isnan(values)
    count = known.sum(axis=0).astype(float)
    some = count > 0
    divisor = np.where(some, count, 1.0)
    zeroed = np.where(known, values, 0.0)
    return Summary(
        count,
        np.where(some, np.where(known, values, np.inf).min(axis=0, initial=np.inf), np.nan),
        np.where(some, np.where(known, values, -np.inf).max(axis=0, initial=-np.inf), np.nan),
        np.where(some, zeroed.sum(axis=0) / divisor, np.nan),
        np.where(some, np.sqrt((zeroed**2).sum(axis=0) / divisor), np.nan),
    )


def combined(parts: Iterable[Summary]) -> Summary:
    """The summary of all samples that the parts were made of; raises ContractError for no part."""
    listed = list(parts)
    if not listed:
        raise ContractError("no summaries to combine")
    count = np.array([part.count for part in listed])
    some = count.sum(axis=0) > 0
    weight = count / np.where(some, count.sum(axis=0), 1.0)
    least = np.array([np.where(part.count > 0, part.minimum, np.inf) for part in listed]).min(axis=0)
    most = np.array([np.where(part.count > 0, part.maximum, -np.inf) for part in listed]).max(axis=0)
    mean = (weight * [np.nan_to_num(part.mean) for part in listed]).sum(axis=0)
    square = (weight * [np.nan_to_num(part.rms) ** 2 for part in listed]).sum(axis=0)
    values = (least, most, mean, np.sqrt(square))
    return Summary(count.sum(axis=0), *(np.where(some, value, np.nan) for value in values))


def summary_of_motion(motion: Motion) -> Summary:
    """Of a block's nine channels: displacement, velocity, acceleration, each east, north, up."""
    channels = (motion.displacement_enu_m, motion.velocity_enu_m_s, motion.acceleration_enu_m_s2)
    return summary(np.hstack(channels))
