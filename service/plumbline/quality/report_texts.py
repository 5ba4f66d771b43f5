"""Words and names of quality reports, for the log and the API."""

from typing import Final

from plumbline.records import QualityReport, Verdict
from plumbline.signals import signal_code

#: What a rejected observation's row says.
REASONS: Final = {
    Verdict.ACCEPTED: "",
    Verdict.OUTLIER: "w-test: outlier",
    Verdict.SLIP: "w-test: cycle slip, the phase stays off by the same amount",
    Verdict.UNDECIDED: "phase off: outlier or cycle slip, the next epochs tell",
    Verdict.INSEPARABLE: "cannot be told from another observation's error",
    Verdict.SLOW_BIAS: "slow bias found over a window",
    Verdict.EPOCH: "the epoch's observations contradict each other",
}


def names_of_signals(report: QualityReport, i: int) -> list[str]:
    """RINEX names of the signals that an observation is made of: C1C, L2W …"""
    letter = "L" if report.is_phase[i] else "C"
    return [letter + signal_code(int(signal)) for signal in report.signals[i] if signal >= 0]
