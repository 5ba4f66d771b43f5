"""How far back the books that stations share give the answers of the past.

A station that is taken over goes on from its checkpoint, behind the books of its new worker: within this time it finds
what it would have found then, and nothing has to be fed again.
"""

from typing import Final

from plumbline.gps_time import NS_PER_S

HISTORY_NS: Final = 60 * NS_PER_S  # of receive time
