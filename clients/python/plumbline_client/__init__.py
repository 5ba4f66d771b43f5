"""Client of a plumbline server."""
