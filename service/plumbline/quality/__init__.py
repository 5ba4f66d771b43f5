"""What a solution is worth, and why there is none.

reliability            an epoch's redundancy numbers, MDBs, external reliability, DOPs and protection levels
report                 them as a record, and as a line of the quality log
structure_or_receiver  whether a displacement is the structure's or the receiver's: what each witness says of an epoch
course                 an antenna's displacement against what it was in the last minutes
doubt                  suspicions over time: how they begin, last and end
reference_watch        whether a reference station stands still (CUSUM)
reference_feed         a base's stream into the books, and its own precise position watched
receiver_events        what a receiver's epochs tell of its tracking, counted
explain                why epochs have no solution or a poor one, in words to act on
availability           epochs expected, received, solved, converged, fixed, and the reasons of loss
"""
