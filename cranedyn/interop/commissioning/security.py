"""What protects an OPC UA server from other machines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple


class Security(NamedTuple):
    """Certificate of a server, and whom it lets in. Clients encrypt what they send.

    Attributes:
        certificate: File of the certificate of the server.
        key: File of the private key of that certificate.
        user: Name of the only user.
        password: Password of that user.
        trusted: Certificates of the clients that get in, as files or folders of them; None lets in
            a client with any certificate.
    """

    certificate: Path
    key: Path
    user: str
    password: str
    trusted: Sequence[Path] | None
