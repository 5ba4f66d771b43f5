"""The live path between processes and machines: zenoh, and nothing else here knows it.

Bus        a zenoh session: publish (reliable, blocking), subscribe in batches, query, answer, liveliness
keys       every key expression
codec      records as MessagePack and back
messages   what travels: raw chunks, clock ticks, outputs, checkpoints
"""

from plumbline.bus import codec, keys, messages
from plumbline.bus.session import Bus, Inbox, Message, Outbox

__all__ = ["Bus", "Inbox", "Message", "Outbox", "codec", "keys", "messages"]
