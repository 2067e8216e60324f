"""Sections of a rig file that reach one wire or one device under several names."""

from __future__ import annotations

import re
import socket
import time
from pathlib import Path

import pytest

from drivers.rig.connection import RigConnection
from drivers.rig_file.host_address import addresses, is_own
from drivers.rig_file.reader import RigFileError, load_rig
from drivers.rig_file.wires import device_of_bus, wire_of_bus
from tests.contract.test_shared_lines import Line, good

HOSTS = ("127.0.0.1", "localhost", "127.1")


@pytest.fixture(autouse=True)
def name_server(monkeypatch):
    """Names of hosts and what is behind them; anything else is resolved by this machine. Each question is listed."""
    known = {"plc-a.lan": ("192.0.2.1",), "plc-b.lan": ("192.0.2.2",), "both.lan": ("192.0.2.2", "192.0.2.9")}
    asked: list[str] = []
    ours = socket.getaddrinfo

    def answer(host, *rest, **kinds):
        asked.append(host)
        if host in known:
            return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, 0)) for address in known[host]]
        return ours(host, *rest, **kinds)

    monkeypatch.setattr("drivers.rig_file.host_address.socket.getaddrinfo", answer)
    monkeypatch.setattr("drivers.rig_file.wires._known", addresses)  # which remembers across tests
    return asked


def rig_file(folder: Path, hosts: tuple[str, ...], port: int = 5020, ids: tuple[int, ...] = (1, 2, 3)) -> Path:
    """A gateway that is called otherwise in each section."""
    parts = ['[rig]\nname = "gateway"\n']
    for number, (host, device) in enumerate(zip(hosts, ids, strict=False), 1):
        parts.append(
            f'[bus.d{number}]\ntransport = "modbus_tcp"\nhost = "{host}"\nport = {port}\ndevice_id = {device}\n'
            f'[[point]]\nname = "p{number}"\nbus = "d{number}"\nunit = "1"\ntable = "input"\naddress = 0\n'
        )
    path = folder / "rig.toml"
    path.write_text("\n".join(parts), encoding="utf-8")
    return path


async def test_devices_of_a_gateway_with_several_names_share_one_connection(tmp_path):
    async with Line(mbap=True) as line:
        connection = RigConnection(load_rig(rig_file(tmp_path, HOSTS, line.port)), time.monotonic)
        try:
            await connection.connect()
            assert good(connection, await connection.read()) == {"d1", "d2", "d3"}
            assert line.connections == 1
        finally:
            await connection.close()


@pytest.mark.parametrize(
    "hosts", [HOSTS[:2], ("plc-b.lan", "192.0.2.2"), ("PLC-A.lan", "plc-a.lan."), ("[::1]", "::1")]
)
def test_one_device_under_two_names_is_a_mistake_that_gives_both(tmp_path, hosts):
    said = (
        r"rig\.toml, line \d+: bus d2 and bus d1 are the same device on the same wire "
        rf"\(host '{re.escape(hosts[1])}' and '{re.escape(hosts[0])}'\); make one section of both"
    )
    with pytest.raises(RigFileError, match=said):
        load_rig(rig_file(tmp_path, hosts, ids=(4, 4)))


def test_two_addresses_of_this_machine_are_one_device_and_two_wires(tmp_path):
    with pytest.raises(RigFileError, match="bus d2 and bus d1 are the same device on one port of this machine"):
        load_rig(rig_file(tmp_path, ("127.0.0.1", "127.0.0.2"), ids=(1, 1)))
    apart = load_rig(rig_file(tmp_path, ("127.0.0.1", "127.0.0.2")))
    assert wire_of_bus(apart) == device_of_bus(apart) == {"d1": "d1", "d2": "d2"}


def test_other_hosts_and_other_ports_are_other_wires(tmp_path, name_server):
    rig = load_rig(rig_file(tmp_path, ("plc-a.lan", "plc-b.lan", "both.lan")))
    assert wire_of_bus(rig) == {"d1": "d1", "d2": "d2", "d3": "d2"}  # one address of both.lan is plc-b's
    name_server.clear()
    rig = rig.with_ports({"d1": 5021, "d2": 5022})
    assert wire_of_bus(rig) == {"d1": "d1", "d2": "d2", "d3": "d3"}
    assert not name_server  # nothing to compare, nothing to ask


def test_links_to_one_serial_line_are_one_wire(tmp_path):
    (tmp_path / "by-id").symlink_to("/dev/null")
    parts = ['[rig]\nname = "line"\n']
    for number, line in enumerate((tmp_path / "by-id", "/dev/null"), 1):
        parts.append(
            f'[bus.d{number}]\ntransport = "modbus_rtu"\nserial_port = "{line}"\ndevice_id = 3\n'
            f'[[point]]\nname = "p{number}"\nbus = "d{number}"\nunit = "1"\ntable = "input"\naddress = 0\n'
        )
    (tmp_path / "rig.toml").write_text("\n".join(parts), encoding="utf-8")
    with pytest.raises(RigFileError, match=r"are the same device on the same wire \(serial_port '/dev/null' and "):
        load_rig(tmp_path / "rig.toml")


def test_an_address_of_an_interface_is_this_machine_and_one_of_nobody_is_not(monkeypatch):
    asked: list[object] = []

    class Probe(socket.socket):
        def connect(self, address):
            asked.append(address[0])

        def getsockname(self):
            return ("198.51.100.4", 40000)  # of our only interface

    monkeypatch.setattr("drivers.rig_file.host_address.socket.socket", Probe)
    assert is_own("198.51.100.4") and not is_own("198.51.100.5") and not is_own("no.such.host")
    assert asked == ["198.51.100.4", "198.51.100.5"]


def test_a_link_local_address_keeps_its_zone(monkeypatch):
    def zones(host, *_args, **_kinds):
        return [(socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("fe80::1%eth0", 0, 0, int(host[-1])))]

    monkeypatch.setattr("drivers.rig_file.host_address.socket.getaddrinfo", zones)
    assert addresses("fe80::1%2") == ("fe80::1%2",) != addresses("fe80::1%3")
