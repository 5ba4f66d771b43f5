"""The tree of errors.

    PlumblineError
    ├── ContractError        a caller broke a documented contract (a bug: it raises)
    ├── ConfigurationError   settings that cannot be served; the text says which and why
    ├── FileFormatError      a file given on the command line is not what it claims to be
    ├── RegistrationError    a device that may not talk to this server; the text says why
    └── StoreError           the database refuses, or is away for longer than the store waits

Bad bytes in a stream are not errors: they are counted with a reason. An epoch without a solution is not an error
either: it is a status with a reason (see :class:`plumbline.records.Status`).
"""


class PlumblineError(Exception):
    """Root of everything this package raises on purpose."""


class ContractError(PlumblineError):
    """A documented contract was broken by the caller."""


class ConfigurationError(PlumblineError):
    """A setting is missing, contradictory or out of range."""


class FileFormatError(PlumblineError):
    """A file is not in the format that its reader understands."""


class RegistrationError(PlumblineError):
    """A device could not be admitted."""


class StoreError(PlumblineError):
    """The database refused, or could not be reached in time; nothing of the transaction is stored."""
