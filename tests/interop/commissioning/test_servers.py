"""The words of a plant over OPC UA and Modbus, as real clients of both see them."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import csv
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from cranedyn.__main__ import main
from cranedyn.data.trajectory import read
from cranedyn.errors import CraneError, DataError
from cranedyn.interop.commissioning import serve
from cranedyn.interop.commissioning import words as w
from cranedyn.interop.commissioning.security import Security
from cranedyn.interop.commissioning.served_crane import ServedCrane
from cranedyn.model.load import load_crane
from cranedyn.recording.process import free_port
from tests.helpers import ROOT

asyncua = pytest.importorskip("asyncua", reason="extra serve (asyncua) is not installed")
pymodbus = pytest.importorskip("pymodbus", reason="extra serve (pymodbus) is not installed")
from asyncua import ua  # noqa: E402
from pymodbus.client import ModbusTcpClient  # noqa: E402

pytestmark = pytest.mark.slow
HOST = "127.0.0.1"


class Served:
    """A plant that is served, and stepped by the test."""

    def __init__(self) -> None:
        self.plant = ServedCrane(load_crane(), duration=300.0)
        self.opcua = (HOST, free_port())
        self.modbus = (HOST, free_port())

    def client(self) -> Any:
        """A client of Modbus."""
        return ModbusTcpClient(HOST, port=self.modbus[1], timeout=60.0)

    def ask(self, work: Any) -> Any:
        """The answer of a coroutine with a client of OPC UA."""

        async def session() -> Any:
            async with asyncua.Client(f"opc.tcp://{HOST}:{self.opcua[1]}/") as client:
                return await work(client)

        return asyncio.run(session())

    def run(self, seconds: float) -> None:
        """Step the plant."""
        for _ in range(round(seconds / 5e-3)):
            self.plant.cycle()


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    it = Served()
    with serve.servers(it.plant, it.opcua, it.modbus):
        yield it


def node(client: Any, name: str) -> Any:
    return client.get_node(f"ns=2;s={name}")


def test_the_map_in_csv_leads_to_every_word_in_both_protocols(
    served: Served, tmp_path: Path
) -> None:
    words = served.plant.image.words
    file = w.write_map(tmp_path / "words.csv", words)
    with file.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(words) == 30
    expected = {}
    with served.client() as client:
        for i, row in enumerate(rows):
            if row["direction"] == "command":
                value = -7 * i if row["type"] == "INT16" else 7 * i
                assert row["modbus_table"] == "holding"
                address = int(row["modbus_address"])
                assert not client.write_register(address, value & 0xFFFF).isError()
                expected[row["name"]] = value
        assert served.plant.image.commands == expected
        served.plant.image.readings = {
            word.name: (-70_000 if word.kind == "INT32" else -3 if word.kind == "INT16" else 9)
            for word in words
            if not word.command
        }
        expected |= served.plant.image.readings
        for row in rows:
            table = client.read_holding_registers
            if row["direction"] == "reading":
                table = client.read_input_registers
            kind = getattr(client.DATATYPE, row["type"])
            answer = table(int(row["modbus_address"]), count=kind.value[1])
            number = client.convert_from_registers(answer.registers, kind)
            assert number == expected[row["name"]], row["name"]

    async def look(client: Any) -> list[Any]:
        nodes = [client.get_node(row["opc_ua_node"]) for row in rows]
        assert len(await (await client.nodes.objects.get_child("2:Crane")).get_children()) == 30
        return await client.read_values(nodes)

    assert served.ask(look) == [expected[row["name"]] for row in rows]
    served.plant.image.commands.update(dict.fromkeys(served.plant.image.commands, 0))
    served.run(0.01)
    with pytest.raises(DataError, match="it is there already"):
        w.write_map(file, words)


def test_opc_ua_takes_commands_of_their_type_only_and_reports_changes(served: Served) -> None:
    async def drive(client: Any) -> list[int]:
        seen: list[int] = []

        class Handler:
            def datachange_notification(self, node: Any, value: int, data: Any) -> None:
                seen.append(value)

        subscription = await client.create_subscription(20, Handler())
        await subscription.subscribe_data_change(node(client, "cycle"))
        speed = node(client, "x.speed")
        await speed.write_value(ua.Variant(-500, ua.VariantType.Int16))
        assert await speed.read_value() == served.plant.image.commands["x.speed"] == -500
        for wrong in (1.5, "fast", ua.Variant([1, 2], ua.VariantType.Int16), ua.Variant(None)):
            with pytest.raises(ua.UaError):
                await speed.write_value(wrong)
        with pytest.raises(ua.UaError):
            await node(client, "x.encoder").write_value(ua.Variant(1, ua.VariantType.Int32))
        assert await speed.read_value() == -500
        async with asyncio.timeout(60.0):
            while len(seen) < 4:
                served.run(0.05)
                await asyncio.sleep(0.02)
        await subscription.delete()
        return seen

    seen = served.ask(drive)
    assert seen == sorted(seen)
    served.plant.image.commands["x.speed"] = 0


def test_no_variant_of_opc_ua_brings_what_is_no_number_of_a_word(served: Served) -> None:
    kinds = ua.VariantType
    numbers = [np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, -0.0, 0.5, 1.0]
    variants = [ua.Variant(x, kinds.Double) for x in numbers]
    variants += [ua.Variant(x, kinds.Float) for x in (np.nan, np.inf, -np.inf, 3e38)]
    variants += [ua.Variant(x, kinds.Int64) for x in (-(2**63), 2**63 - 1, 1)]
    variants += [ua.Variant(2**32 - 1, kinds.UInt32), ua.Variant(2**64 - 1, kinds.UInt64)]
    variants += [ua.Variant("NaN", kinds.String), ua.Variant(b"\x00\x7f", kinds.ByteString)]
    variants += [ua.Variant(True, kinds.Boolean), ua.Variant([], kinds.Int16, is_array=True)]
    variants += [ua.Variant([np.nan], kinds.Double), ua.Variant(None, kinds.Null)]
    names = [word.name for word in served.plant.image.words if word.command]
    before = served.plant.image.commands.copy()

    async def write_all(client: Any) -> int:
        refused = 0
        for name in names:
            for variant in variants:
                with pytest.raises(ua.UaError):
                    await node(client, name).write_value(ua.DataValue(variant))
                refused += 1
        return refused

    assert served.ask(write_all) == len(names) * len(variants)
    assert served.plant.image.commands == before
    served.run(0.1)
    assert served.ask(lambda client: node(client, "fault").read_value()) == 0


def test_every_register_of_modbus_is_a_whole_number_of_its_word(served: Served) -> None:
    commands = [word for word in served.plant.image.words if word.command]
    rng = np.random.default_rng(0)
    with served.client() as client:
        for _ in range(50):
            first = int(rng.integers(len(commands)))
            registers = rng.choice([0, 1, 0x7F80, 0x7FFF, 0x8000, 0xFFFF], len(commands) - first)
            assert not client.write_registers(first, registers.tolist()).isError()
            for word, register in zip(commands[first:], registers.tolist(), strict=True):
                assert word.holds(served.plant.image.commands[word.name])
                assert served.plant.image.commands[word.name] & 0xFFFF == register
    served.plant.image.commands.update(dict.fromkeys(served.plant.image.commands, 0))
    served.run(0.01)


def test_modbus_refuses_what_is_not_there_and_survives_garbage(served: Served) -> None:
    with socket.create_connection(served.modbus) as raw:
        raw.sendall(bytes(range(256)) * 4)
    with served.client() as client:
        assert client.read_input_registers(200, count=1).isError()
        assert client.write_registers(14, [1, 2]).isError()
        answer = client.readwrite_registers(
            read_address=0, read_count=3, write_address=1, values=[450]
        )
        assert answer.registers[1] == served.plant.image.commands["wind"] == 450
        assert not client.write_registers(1, [0]).isError()
    with socket.create_connection(served.opcua) as raw:
        raw.sendall(b"HELF" + bytes(60))
    assert served.ask(lambda client: node(client, "fault").read_value()) == 0


@pytest.mark.parametrize("announced", [2**31 - 1, 2**16, 8, 0])
@pytest.mark.parametrize("greeted", [False, True])
def test_a_message_larger_than_the_buffer_closes_its_connection_before_it_is_collected(
    announced: int, greeted: bool, served: Served
) -> None:
    # asyncua itself closes a connection after 30 s without a session.
    with socket.create_connection(served.opcua, timeout=20.0) as stranger:
        if greeted:
            url = b"opc.tcp://crane/"
            hello = struct.pack("<6I", 0, 65535, 65535, 0, 0, len(url)) + url
            stranger.sendall(b"HELF" + struct.pack("<I", 8 + len(hello)) + hello)
            assert stranger.recv(1000).startswith(b"ACKF")
        stranger.sendall(b"MSGF" + struct.pack("<I", announced))
        assert stranger.recv(1000) == b""  # closed by the server
    assert served.ask(lambda client: node(client, "fault").read_value()) == 0


def test_a_message_of_many_chunks_is_no_larger_than_sixteen_of_them() -> None:
    from cranedyn.interop.commissioning.opcua import serve_opcua

    async def limits() -> Any:
        server = await serve_opcua(ServedCrane(load_crane(), duration=1.0).image, HOST, free_port())
        await server.stop()
        return server.limits

    bound = asyncio.run(limits())
    assert (bound.max_chunk_count, bound.max_message_size) == (16, 16 * 65535)


def test_bad_packets_are_counted_and_print_no_tracebacks(
    capfd: pytest.CaptureFixture[str],
) -> None:
    plant = ServedCrane(load_crane(), duration=1.0)
    opcua = (HOST, free_port())
    modbus = (HOST, free_port())
    with serve.servers(plant, opcua, modbus):
        for place in (opcua, modbus):
            for packet in (b"HELF" + struct.pack("<I", 60) + bytes(52), bytes(range(256)) * 4):
                with socket.create_connection(place, timeout=60.0) as raw:
                    raw.sendall(packet)
                    raw.shutdown(socket.SHUT_WR)
                    with contextlib.suppress(ConnectionError):
                        while raw.recv(1000):
                            pass
    printed, complaints = capfd.readouterr()
    assert complaints == ""
    assert re.search(r"the servers could not use; errors reported: [1-9]", printed)


def test_a_busy_port_is_one_sentence(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with socket.create_server((HOST, 0)) as busy:
        for protocol, name in (("opcua", "OPC UA"), ("modbus", "Modbus")):
            port = busy.getsockname()[1]
            out = str(tmp_path / protocol)
            assert main(["serve", f"--{protocol}", f"{HOST}:{port}", "--out", out]) == 2
            complaint = f"error: {name} cannot listen at {HOST}:{port}; is the port taken?\n"
            assert capfd.readouterr().err == complaint


def test_a_folder_that_cannot_be_written_is_refused_before_anything_is_served(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serve, "servers", lambda *_: pytest.fail("it is served"))
    (tmp_path / "file").touch()
    for out in (tmp_path / "file" / "run", Path("/proc/run")):
        assert main(["serve", "--modbus", f"{HOST}:{free_port()}", "--out", str(out)]) == 2
        assert f"Cannot write {out}" in capsys.readouterr().err


def test_ctrl_c_ends_within_two_seconds_and_a_second_one_loses_nothing(tmp_path: Path) -> None:
    out = tmp_path / "run"
    ports = [free_port(), free_port()]
    command = [sys.executable, "-m", "cranedyn", "serve", "--opcua", f"{HOST}:{ports[0]}"]
    command += ["--modbus", f"{HOST}:{ports[1]}", "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        assert process.stdout is not None
        lines = iter(process.stdout.readline, "")
        assert any("Ctrl-C" in line for line in lines)
        time.sleep(1.0)
        # The promise is of wall time; beside other tests only the processor's is of this process.
        before = after = sum(psutil.Process(process.pid).cpu_times()[:2])
        process.send_signal(signal.SIGINT)
        assert any("cycles of" in line for line in lines)
        with contextlib.suppress(psutil.Error):
            while process.poll() is None:
                if not out.exists():  # while connections close and files are written
                    process.send_signal(signal.SIGINT)
                after = sum(psutil.Process(process.pid).cpu_times()[:2])
                time.sleep(0.01)
        assert after - before < 2.0
        assert process.wait(60.0) == 0
        assert len(read(out / "serve.parquet")) > 0
        assert (out / "serve.rrd").is_file()
    finally:
        process.kill()
        process.wait()


CLIENT = """
import sys, time
from pymodbus.client import ModbusTcpClient
client = ModbusTcpClient("127.0.0.1", port=int(sys.argv[1]))
client.connect()
beat = 0
while True:
    beat = (beat + 1) % 65536
    client.write_registers(0, [beat])
    client.write_registers(7, [1, 8192])
    print(beat, flush=True)
    time.sleep(0.02)
"""


@pytest.mark.parametrize("way", ["killed", "half open"])
def test_a_client_that_is_killed_or_falls_silent_stops_the_crane(way: str, served: Served) -> None:
    served.plant.events.clear()
    command = [sys.executable, "-c", CLIENT, str(served.modbus[1])]
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    try:
        for _ in range(40):
            assert process.stdout is not None
            assert process.stdout.readline()
            served.run(0.05)
        assert served.plant.state.v[1] > 0.5
        assert not served.plant.fault
        if way == "killed":
            process.kill()
        else:
            process.send_signal(19)  # stopped: its connection stays open and silent
        served.run(4.0)
        ((_, text),) = served.plant.events
        assert text == w.FAULTS[w.WATCHDOG_FAULT]
        assert abs(served.plant.state.v[1]) < 1e-3
    finally:
        process.kill()
        process.wait()
    served.plant.image.commands["x.control"] = 0
    served.run(0.1)
    served.plant.image.commands["x.control"] = w.RESET_BIT
    served.run(0.1)
    served.plant.image.commands["x.control"] = 0
    assert not served.plant.fault


def options(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    serve.add_arguments(parser)
    return parser.parse_args(words)


def test_beyond_this_machine_opc_ua_needs_a_certificate_and_a_user_and_modbus_a_word(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(serve.PASSWORD_VARIABLE, raising=False)
    with pytest.raises(CraneError, match="--certificate, --key, --user, --trust, and a"):
        serve.check_exposure(options("--opcua", "0.0.0.0:4840"))
    with pytest.raises(CraneError, match="--certificate"):
        serve.check_exposure(options("--opcua", "127.0.0.1:4840", "--user", "anna"))
    with pytest.raises(CraneError, match="Modbus has no security"):
        serve.check_exposure(options("--modbus", "192.168.0.7:5020"))
    assert serve.check_exposure(options("--modbus", "0.0.0.0:502", "--insecure-modbus")) is None
    assert serve.check_exposure(options("--opcua", "localhost:4840", "--modbus", "::1:5")) is None
    monkeypatch.setenv(serve.PASSWORD_VARIABLE, "hoist")
    words = ("--certificate", "c", "--key", "k", "--user", "anna")
    assert serve.check_exposure(options("--opcua", "localhost:4840", *words)).trusted is None
    with pytest.raises(CraneError, match="--trust"):
        serve.check_exposure(options("--opcua", "0.0.0.0:4840", *words))
    trusting = options("--opcua", "0.0.0.0:4840", *words, "--trust", "a", "b")
    assert serve.check_exposure(trusting).trusted == [Path("a"), Path("b")]
    for wrong in ("4840", "host:", "host:0", "host:70000", ":5020"):
        with pytest.raises(DataError, match="HOST:PORT"):
            serve.address(wrong)


def test_only_the_user_with_the_password_and_a_trusted_certificate_gets_in(tmp_path: Path) -> None:
    from asyncua.crypto.cert_gen import setup_self_signed_certificate
    from cryptography.x509.oid import ExtendedKeyUsageOID

    key = tmp_path / "key.pem"
    certificate = tmp_path / "certificate.der"
    uses = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    names = {}
    uri = "urn:freeopcua:python:server"
    asyncio.run(setup_self_signed_certificate(key, certificate, uri, HOST, uses, names))
    plant = ServedCrane(load_crane(), duration=1.0)
    place = (HOST, free_port())
    other = tmp_path / "other_key.pem", tmp_path / "other.der"
    asyncio.run(setup_self_signed_certificate(*other, uri, HOST, uses, names))

    async def enter(user: str | None, password: str, encrypted: bool = True) -> int:
        client = asyncua.Client(f"opc.tcp://{HOST}:{place[1]}/")
        client.application_uri = uri
        if encrypted:
            await client.set_security_string(f"Basic256Sha256,SignAndEncrypt,{certificate},{key}")
        if user:
            client.set_user(user)
            client.set_password(password)
        async with client:
            return await node(client, "fault").read_value()

    login = certificate, key, "anna", "hoist"
    (trusted := tmp_path / "trusted").mkdir()
    shutil.copy(other[1], trusted)
    with serve.servers(plant, place, None, Security(*login, [trusted])):
        with pytest.raises(Exception, match=r"(?i)denied|reject|token|identity"):
            asyncio.run(enter("anna", "hoist"))
    with serve.servers(plant, place, None, Security(*login, [trusted, certificate])):
        assert asyncio.run(enter("anna", "hoist")) == 0
        for login in (("anna", "hois"), ("ann", "hoist"), ("admin", ""), (None, "")):
            with pytest.raises(Exception, match=r"(?i)denied|reject|token|identity|policy"):
                asyncio.run(enter(*login))
        with pytest.raises(Exception, match=r"(?i)endpoint|policy|security"):
            asyncio.run(enter("anna", "hoist", encrypted=False))
    with (
        pytest.raises(CraneError, match="cannot be read"),
        serve.servers(plant, place, None, Security(key, certificate, "anna", "hoist", None)),
    ):
        pass


def test_the_command_keeps_the_clock_records_the_run_and_replaces_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    port = free_port()
    command = ["serve", "--modbus", f"{HOST}:{port}", *"--duration 6 --speed 4 --out".split()]
    command.append(str(out))
    keep_time = serve.keep_time
    began = time.perf_counter()

    def keep_time_when_driven(*arguments: Any) -> str:
        with ModbusTcpClient(HOST, port=port, timeout=60.0) as client:
            client.write_registers(7, [w.ENABLE_BIT, 16384])
        return keep_time(*arguments)

    monkeypatch.setattr(serve, "keep_time", keep_time_when_driven)
    assert main(command) == 0
    assert time.perf_counter() - began > 1.49
    printed = capsys.readouterr().out
    assert "1200 cycles of 1.25 ms" in printed
    assert w.FAULTS[w.WATCHDOG_FAULT] in printed
    run = read(out / "serve.parquet")
    assert len(run) == 1200
    assert (out / "serve.rrd").stat().st_size > 10_000
    assert run.record["notes"]["events"][0][1] == w.FAULTS[w.WATCHDOG_FAULT]
    assert np.ptp(run["x_m"]) > 0.001
    assert main(command) == 2
    assert "it is there already" in capsys.readouterr().err
    busy = socket.create_server((HOST, port))
    assert main([*command[:-1], str(tmp_path / "other")]) == 2
    assert "cannot listen" in capsys.readouterr().err
    busy.close()
    assert main(["serve"]) == 2
    assert "nothing to serve" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.usefixtures("limited")
def test_a_hundred_clients_are_served_while_the_clock_runs() -> None:
    plant = ServedCrane(load_crane(), duration=600.0)
    place = (HOST, free_port())
    stop = threading.Event()
    readers: set[int] = set()

    async def read_on(number: int) -> None:
        async with asyncua.Client(f"opc.tcp://{HOST}:{place[1]}/", timeout=60) as client:
            while not stop.is_set():
                await node(client, "cycle").read_value()
                readers.add(number)
                await asyncio.sleep(0.5)

    async def all_clients() -> None:
        await asyncio.gather(*(read_on(i) for i in range(100)))

    thread = threading.Thread(target=lambda: asyncio.run(all_clients()))
    with serve.servers(plant, place):
        thread.start()
        while len(readers) < 100:
            assert "200 cycles" in serve.keep_time(plant, 200)
        stop.set()
        thread.join(60.0)
