"""What the motion says of the structure: summaries and spectra."""

from plumbline.structure.spectrum import Peak, Spectrum, peaks, power_spectrum
from plumbline.structure.statistics import Summary, combined, summary, summary_of_motion

__all__ = ["Peak", "Spectrum", "Summary", "combined", "peaks", "power_spectrum", "summary", "summary_of_motion"]
