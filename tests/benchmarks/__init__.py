"""Speed against the peers, measured on the same input in the same run: `make bench`."""
