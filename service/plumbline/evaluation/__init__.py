"""How good results are where the truth is known: the shaking table of Dai 2024, scheme by scheme.

A composition root beside ``worker``: reads what ``plumbline process`` wrote and the truth beside it, computes the
paper's table 3, spectra's peaks and amplitude errors, and draws the paper's figures.
"""
