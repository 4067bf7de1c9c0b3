"""The words of a plant as OPC UA nodes, by asyncua."""

from __future__ import annotations

import asyncio
import hmac
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cranedyn.errors import CraneError
from cranedyn.interop.commissioning.security import Security
from cranedyn.interop.commissioning.words import NAMESPACE, ProcessImage, Word

try:
    import asyncua.server.server as asyncua_server
    from asyncua import Server, ua
    from asyncua.crypto.permission_rules import User, UserRole
    from asyncua.crypto.uacrypto import load_certificate
    from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
    from asyncua.server.user_managers import UserManager
    from cryptography.hazmat.primitives.serialization import Encoding
except ModuleNotFoundError as error:
    raise CraneError(
        "OPC UA needs asyncua, which is not installed: pip install 'cranedyn[serve]'."
    ) from error

_logger = logging.getLogger("asyncua.cranedyn")

PUBLISH_PERIOD = 0.05
"""Time between reports of readings to subscriptions [s]; a read gets those of the latest cycle."""

MAX_CHUNK = 65_535
"""Largest size of a chunk, the piece of a message that has a header of its own [byte]."""

MAX_CHUNKS_OF_MESSAGE = 16
"""Largest number of chunks of a message."""

_HEADER = 8
"""Bytes of the header of a chunk: three letters of its type, its kind, and its size as UInt32
(OPC UA Part 6, 7.1.2.2)."""

_LARGEST_PAUSE = 0.25
"""Longest time for which a connection that sends too fast is not read [s]."""

_CHUNKS_PER_SECOND = 2000.0
"""Rate at which the chunks of one connection are read. A program that reads and writes all words in
every cycle of the plant sends 400."""

_KINDS = {
    "UINT16": ua.VariantType.UInt16,
    "INT16": ua.VariantType.Int16,
    "INT32": ua.VariantType.Int32,
}
"""Types of OPC UA by those of words."""


class _OneUser(UserManager):
    """Lets in one user, with a password and, if certificates are asked for, a trusted one."""

    def __init__(self, user: str, password: str, trusted: set[bytes] | None) -> None:
        self._login = f"{user}\n{password}".encode()
        self._trusted = trusted

    def get_user(
        self, iserver: Any, username: Any = None, password: Any = None, certificate: Any = None
    ) -> User | None:
        """Return the user, None for somebody who does not get in."""
        # The comparison takes as long wherever the first difference is, so that its time does not
        # tell how much of a guess was right.
        is_right_login = hmac.compare_digest(f"{username}\n{password}".encode(), self._login)
        is_trusted = self._trusted is None or certificate in self._trusted
        return User(UserRole.User, username) if is_right_login and is_trusted else None


class _BoundedProtocol(OPCUAProtocol):
    """A connection that keeps no more than one incomplete chunk.

    asyncua collects whatever a header announces, up to 4 GB, before it looks at certificate and
    user. Here a chunk larger than `MAX_CHUNK` closes the connection. Chunks are handed on one by
    one, because asyncua copies all that it has received for each chunk that it takes from it.
    """

    def __init__(self, *args: Any, **arguments: Any) -> None:
        super().__init__(*args, **arguments)
        self._received = bytearray()

    def data_received(self, data: bytes) -> None:
        """Hand on the chunks that are complete; close the connection at one that is too large."""
        if self.transport is None or self.transport.is_closing():
            return
        self._received += data
        chunks = 0
        while len(self._received) >= _HEADER:
            size = int.from_bytes(self._received[4:_HEADER], "little")
            if not _HEADER < size <= MAX_CHUNK:
                self._refuse(f"a chunk of {size} bytes")
                return
            if len(self._received) < size:
                break
            chunk = bytes(self._received[:size])
            del self._received[:size]
            super().data_received(chunk)
            chunks += 1
            if self.transport.is_closing():
                self._received.clear()
                return
            if self._buffer:
                # asyncua did not take the chunk: its header is none of OPC UA. It would keep all
                # that follows.
                self._refuse("a header that is none of OPC UA")
                return
        self._pause(chunks / _CHUNKS_PER_SECOND)

    def _refuse(self, what: str) -> None:
        """Close the connection and forget what it has sent."""
        _logger.error("Connection from %s closed: %s", self.peer_name, what)
        self._received.clear()
        self._buffer = b""
        if self.transport is not None:
            self.transport.close()

    def _pause(self, seconds: float) -> None:
        """Read no more for a while, so that one client does not take the plant's processor."""
        transport = self.transport
        if transport is None or transport.is_closing() or seconds <= 0.0:
            return

        def resume() -> None:
            if not transport.is_closing():
                transport.resume_reading()

        transport.pause_reading()
        asyncio.get_running_loop().call_later(min(seconds, _LARGEST_PAUSE), resume)


class _BoundedServer(BinaryServer):
    """asyncua's socket server with connections of `_BoundedProtocol`."""

    def _make_protocol(self) -> OPCUAProtocol:
        return _BoundedProtocol(
            iserver=self.iserver,
            policies=self._policies,
            clients=self.clients,
            closing_tasks=self.closing_tasks,
            limits=self.limits,
        )


async def listen(server: Server, host: str, port: int) -> None:
    """Start a server whose connections are bounded.

    Args:
        server: The server.
        host: Host at which it listens.
        port: Port at which it listens.

    Raises:
        CraneError: If it cannot listen at this address.
    """
    # asyncua has no argument for the class of its socket server; it looks the name up in `start`.
    original = asyncua_server.BinaryServer
    asyncua_server.BinaryServer = _BoundedServer  # type: ignore[misc]
    try:
        await server.start()
    except OSError as error:
        raise CraneError(f"OPC UA cannot listen at {host}:{port}; is the port taken?") from error
    finally:
        asyncua_server.BinaryServer = original  # type: ignore[misc]


async def serve_opcua(
    image: ProcessImage, host: str, port: int, security: Security | None = None
) -> Server:
    """Return a server of the words as variables of the object Crane, which runs until its `stop`.

    Args:
        image: The words and their numbers.
        host: Host at which it listens.
        port: Port at which it listens.
        security: What protects it; without it everybody gets in.

    Raises:
        CraneError: If it cannot listen at this address, or a file of the security cannot be read.
    """
    server = await new_server(host, port, security)
    crane = await server.nodes.objects.add_object(f"ns={NAMESPACE};s=Crane", f"{NAMESPACE}:Crane")
    for word in image.words:
        await _add_word(server, crane, image, word)
    await listen(server, host, port)
    return server


async def new_server(host: str, port: int, security: Security | None = None) -> Server:
    """Return a server without nodes of its own, which does not listen yet, see `listen`.

    Args:
        host: Host at which it will listen.
        port: Port at which it will listen.
        security: What protects it; without it everybody gets in.

    Raises:
        CraneError: If a file of the security cannot be read.
    """
    server = Server()
    server.limits.max_chunk_count = MAX_CHUNKS_OF_MESSAGE
    server.limits.max_message_size = MAX_CHUNKS_OF_MESSAGE * MAX_CHUNK
    await server.init()
    # An address of IPv6 has colons, and stands in brackets in a URL.
    host_in_url = f"[{host}]" if ":" in host else host
    server.set_endpoint(f"opc.tcp://{host_in_url}:{port}/")
    if security is None:
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        server.set_identity_tokens([ua.AnonymousIdentityToken])
    else:
        await _secure(server, security)
    await server.register_namespace("urn:cranedyn:crane")  # the first, which is `NAMESPACE`
    return server


async def _secure(server: Server, security: Security) -> None:
    """Have a server encrypt, and let in one user only.

    Raises:
        CraneError: If a file of the security cannot be read.
    """
    try:
        await server.load_certificate(security.certificate)
        await server.load_private_key(security.key)
        trusted = None
        if security.trusted is not None:
            trusted = await _load_trusted(security.trusted)
        server.iserver.user_manager = _OneUser(security.user, security.password, trusted)
    except (OSError, ValueError, TypeError) as error:
        raise CraneError(f"Certificate or key cannot be read: {error}.") from error
    server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
    server.set_identity_tokens([ua.UserNameIdentityToken])


async def _load_trusted(paths: Sequence[Path]) -> set[bytes]:
    """Return certificates, from files and folders of them, in the encoding in which clients send
    theirs.
    """
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            files += path.iterdir()
        else:
            files.append(path)
    trusted = set[bytes]()
    for file in files:
        certificate = await load_certificate(file)
        trusted.add(certificate.public_bytes(Encoding.DER))
    return trusted


async def _add_word(server: Server, crane: Any, image: ProcessImage, word: Word) -> None:
    """Add the node of a word, which reads and writes the image itself, so that no number is kept in
    two places.
    """
    kind = _KINDS[word.kind]
    node = await crane.add_variable(word.node, f"{NAMESPACE}:{word.name}", 0, kind)
    # Bits, codes and counters have neither a scale nor a unit.
    description = f"{word.meaning} [{word.scale:g} {word.unit}]".replace(" [1 ]", "")
    text = ua.LocalizedText(description)
    await node.write_attribute(ua.AttributeIds.Description, ua.DataValue(ua.Variant(text)))

    def read(*_: Any) -> ua.DataValue:
        numbers = image.commands if word.command else image.readings
        return ua.DataValue(ua.Variant(numbers[word.name], kind))

    def write(data: Any, attribute: Any, value: ua.DataValue) -> None:
        variant = value.Value
        if variant is None or variant.VariantType != kind or not isinstance(variant.Value, int):
            raise ua.UaStatusCodeError(ua.StatusCodes.BadTypeMismatch)
        if not word.holds(variant.Value):
            raise ua.UaStatusCodeError(ua.StatusCodes.BadOutOfRange)
        # A reading is written by `publish` alone, for its subscriptions; the image has it already.
        if word.command:
            image.commands[word.name] = variant.Value

    server.set_attribute_value_callback(node.nodeid, read)
    server.set_attribute_value_setter(node.nodeid, write)
    if word.command:
        await node.set_writable()


async def publish(server: Server, image: ProcessImage) -> None:
    """Report readings that have changed to subscriptions, until cancelled."""
    words = {word.name: word for word in image.words}
    last: dict[str, int] = {}
    while True:
        # Each cycle of the plant replaces this dictionary, so these are of one cycle.
        readings = image.readings
        for name, value in readings.items() - last.items():
            word = words[name]
            node = ua.NodeId.from_string(word.node)
            data = ua.Variant(value, _KINDS[word.kind])
            await server.write_attribute_value(node, ua.DataValue(data))
        last = readings
        await asyncio.sleep(PUBLISH_PERIOD)
