"""The words of a plant as OPC UA nodes, by asyncua."""

from __future__ import annotations

import asyncio
import hmac
from pathlib import Path
from typing import Any, NamedTuple

from cranedyn.bridges.commissioning.words import ProcessImage, Word
from cranedyn.errors import CraneError

try:
    from asyncua import Server, ua
    from asyncua.crypto.permission_rules import User, UserRole
    from asyncua.server.user_managers import UserManager
except ModuleNotFoundError as error:
    raise CraneError(
        "OPC UA needs asyncua, which is not installed: pip install 'cranedyn[serve]'."
    ) from error

PUBLISHING = 0.05
"""Time between reports of readings to subscriptions [s]; a read gets the latest cycle."""

_KINDS = {
    "UINT16": ua.VariantType.UInt16,
    "INT16": ua.VariantType.Int16,
    "INT32": ua.VariantType.Int32,
}


class Security(NamedTuple):
    """Files of the server's certificate and private key, and the user that it lets in."""

    certificate: Path
    key: Path
    user: str
    password: str


class _OneUser(UserManager):
    def __init__(self, security: Security) -> None:
        self._expected = security[2:]

    def get_user(
        self, iserver: Any, username: Any = None, password: Any = None, certificate: Any = None
    ) -> User | None:
        """Return the user if name and password are right."""
        login = f"{username}\n{password}".encode()
        right = hmac.compare_digest(login, "\n".join(self._expected).encode())
        return User(UserRole.User, username) if right else None


async def serve_opcua(
    image: ProcessImage, host: str, port: int, security: Security | None
) -> Server:
    """Return a server of the words as variables of the object Crane, which runs until its `stop`.

    Without security it lets in all clients, unencrypted.

    Raises:
        CraneError: If it cannot listen at this address, or a file of the security cannot be read.
    """
    server = Server(user_manager=None if security is None else _OneUser(security))
    await server.init()
    server.set_endpoint(f"opc.tcp://{host}:{port}/")
    token: Any = ua.AnonymousIdentityToken
    policy = ua.SecurityPolicyType.NoSecurity
    if security is not None:
        policy = ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt
        token = ua.UserNameIdentityToken
        try:
            await server.load_certificate(security.certificate)
            await server.load_private_key(security.key)
        except (OSError, ValueError, TypeError) as error:
            raise CraneError(f"Certificate or key cannot be read: {error}.") from error
    server.set_security_policy([policy])
    server.set_identity_tokens([token])
    space = await server.register_namespace("urn:cranedyn:crane")
    crane = await server.nodes.objects.add_object(_node_id(space, "Crane"), f"{space}:Crane")
    for word in image.words:
        await _add_word(server, crane, space, image, word)
    try:
        await server.start()
    except OSError as error:
        raise CraneError(f"OPC UA cannot listen at {host}:{port}; is the port taken?") from error
    return server


async def _add_word(
    server: Server, crane: Any, space: int, image: ProcessImage, word: Word
) -> None:
    """Add a node that reads and writes the image."""
    kind, name = _KINDS[word.kind], ua.QualifiedName(word.name, space)
    node = await crane.add_variable(_node_id(space, word.name), name, 0, kind)
    text = ua.LocalizedText(f"{word.meaning} [{word.scale:g} {word.unit}]".replace(" [1 ]", ""))
    await node.write_attribute(ua.AttributeIds.Description, ua.DataValue(ua.Variant(text)))

    def read(*_: Any) -> ua.DataValue:
        return ua.DataValue(ua.Variant(_numbers(image, word)[word.name], kind))

    def write(data: Any, attribute: Any, value: ua.DataValue) -> None:
        variant = value.Value
        if variant is None or variant.VariantType != kind or not isinstance(variant.Value, int):
            raise ua.UaStatusCodeError(ua.StatusCodes.BadTypeMismatch)
        if word.command:  # a reading is written by `publish` alone, for its subscriptions
            image.commands[word.name] = variant.Value

    server.set_attribute_value_callback(node.nodeid, read)
    server.set_attribute_value_setter(node.nodeid, write)
    if word.command:
        await node.set_writable()


def _node_id(space: int, name: str) -> ua.NodeId:
    return ua.NodeId.from_string(f"ns={space};s={name}")


def _numbers(image: ProcessImage, word: Word) -> dict[str, int]:
    return image.commands if word.command else image.readings


async def publish(server: Server, image: ProcessImage) -> None:
    """Report readings that have changed to subscriptions, until cancelled."""
    space = await server.get_namespace_index("urn:cranedyn:crane")
    kinds = {word.name: _KINDS[word.kind] for word in image.words}
    last: dict[str, int] = {}
    while True:
        readings = image.readings
        for name, value in readings.items() - last.items():
            data = ua.DataValue(ua.Variant(value, kinds[name]))
            await server.write_attribute_value(_node_id(space, name), data)
        last = readings
        await asyncio.sleep(PUBLISHING)
