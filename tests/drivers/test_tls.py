"""Modbus over TLS with certificates both ways, against the virtual rig: who is let in, and what the others are told."""

from __future__ import annotations

import asyncio
import os
import shutil
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers.modbus.bus import ModbusBus
from drivers.modbus.tls import check_key, check_valid, client_context, validity
from drivers.rig_file.bus_sections import ModbusTlsBus
from drivers.rig_file.reader import RigFileError, load_rig
from drivers.signals.points import ConfigurationError, LinkError, Quality
from drivers.virtual.rig import VirtualRig, start_virtual_rig
from hil.bench.faults.tls import Certificates, authority, make_certificates, signed

PROJECT = Path(__file__).resolve().parents[2]
POINTS = tuple(point for point in load_rig(PROJECT / "profiles/rigs/virtual.toml").point if point.bus == "plc")
pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="certificates are made by openssl")


@dataclass
class Secured:
    rig: VirtualRig
    files: dict[str, Path]
    folder: Path
    ca: tuple[Path, Path]

    def bus(self, **changes: object) -> ModbusBus:
        options = {"port": self.rig.modbus_port} | self.files | changes
        config = ModbusTlsBus.model_validate({"transport": "modbus_tls"} | options)
        return ModbusBus("plc", config, POINTS, time.monotonic)

    async def refusal(self, **changes: object) -> str:
        with pytest.raises(LinkError) as caught:
            await self.bus(**changes).connect()
        text = str(caught.value)
        assert "\n" not in text
        return text


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Certificates]:
    """Certificates, made once, and their folder."""
    folder = tmp_path_factory.mktemp("certificates")
    return folder, make_certificates(folder)


@pytest.fixture
async def secured(certificates: tuple[Path, Certificates], tmp_path: Path) -> AsyncIterator[Secured]:
    folder, made = certificates
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    certificate, key, ca = (tmp_path / path.name for path in made.rig)
    files = {name: tmp_path / path.name for name, path in made.harness.items()}
    async with await start_virtual_rig(period_s=0.1, tls=(certificate, key, ca)) as rig:
        yield Secured(rig, files, tmp_path, (tmp_path / "authority.pem", tmp_path / "authority.key"))


async def test_reads_and_writes_go_through_tls_and_nothing_else_does(secured):
    bus = secured.bus()
    await bus.connect()
    await bus.write({"pump_speed_set": 55.0})
    readings = await bus.read()
    assert set(readings.quality) == {Quality.GOOD}
    assert (await bus.read_back(("pump_speed_set",))) == {"pump_speed_set": pytest.approx(55.0)}
    await bus.close()
    context = client_context(secured.bus()._config)  # type: ignore[arg-type]
    assert context.minimum_version == ssl.TLSVersion.TLSv1_2
    assert context.verify_mode == ssl.CERT_REQUIRED
    assert context.check_hostname


async def test_a_rig_of_another_authority_is_refused_by_us(secured):
    other = authority(secured.folder, "other")[0]
    said = await secured.refusal(ca=other)
    assert "the rig's certificate is refused" in said
    assert "other.pem" in said


async def test_a_rig_whose_certificate_names_another_host_is_refused_by_us(secured):
    said = await secured.refusal(host="127.0.0.2")
    assert "cannot be reached" in said or "127.0.0.2" in said


async def test_we_are_refused_with_a_certificate_of_another_authority(secured):
    certificate, key = signed(secured.folder, "stranger", authority(secured.folder, "other"))
    said = await secured.refusal(certificate=certificate, key=key)
    assert "stranger.pem" in said
    assert "another authority than its own has signed it" in said or "does not know the authority" in said


async def test_an_expired_certificate_of_ours_is_said_before_anything_is_opened(secured):
    certificate, key = signed(secured.folder, "expired", secured.ca, days=0)
    await asyncio.sleep(1.1)
    with pytest.raises(ConfigurationError, match=r"expired.pem: has expired on 2\d\d\d-.* UTC; have it renewed"):
        secured.bus(certificate=certificate, key=key)


async def test_a_rig_refuses_an_expired_certificate_by_itself(secured, monkeypatch):
    certificate, key = signed(secured.folder, "expired", secured.ca, days=0)
    await asyncio.sleep(1.1)
    monkeypatch.setattr("drivers.modbus.tls.check_valid", lambda path: None)  # a machine whose clock is behind
    assert "expired.pem" in await secured.refusal(certificate=certificate, key=key)


async def test_an_expired_rig_is_refused_by_us(secured):
    certificate, key = signed(secured.folder, "old_rig", secured.ca, days=0)
    await asyncio.sleep(1.1)
    async with await start_virtual_rig(period_s=0.1, tls=(certificate, key, secured.ca[0])) as rig:
        said = await Secured(rig, secured.files, secured.folder, secured.ca).refusal()
    assert "the rig's certificate is refused: certificate has expired" in said


async def test_a_client_without_a_certificate_gets_nothing(secured):
    context = ssl.create_default_context(cafile=secured.files["ca"])
    context.maximum_version = ssl.TLSVersion.TLSv1_2

    def ask() -> None:
        with (
            socket.create_connection(("127.0.0.1", secured.rig.modbus_port), timeout=3.0) as wire,
            context.wrap_socket(wire, server_hostname="127.0.0.1"),
        ):
            pass

    with pytest.raises((ssl.SSLError, ConnectionError)):
        await asyncio.to_thread(ask)


async def test_tls_1_1_is_refused(secured):
    def ask() -> int:
        command = ["openssl", "s_client", "-connect", f"127.0.0.1:{secured.rig.modbus_port}", "-tls1_1"]
        return subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=20, check=False
        ).returncode

    assert await asyncio.to_thread(ask) != 0


async def test_a_rig_that_speaks_no_tls_is_told_from_one_that_is_off(secured):
    async with await start_virtual_rig(period_s=0.1) as plain:
        said = await secured.refusal(port=plain.modbus_port)
    assert "cannot be reached" in said or "does not speak TLS" in said


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o602])
def test_a_key_that_others_may_read_or_change_is_refused(tmp_path, mode):
    files = make_certificates(tmp_path).harness
    os.chmod(files["key"], mode)
    with pytest.raises(ConfigurationError, match=rf"mode 0{mode:o}\); chmod 600 .*harness.key"):
        client_context(ModbusTlsBus(transport="modbus_tls", **files))
    os.chmod(files["key"], 0o600)
    check_key(files["key"])


def test_files_that_are_no_certificate_are_named(tmp_path):
    files = make_certificates(tmp_path).harness
    other = authority(tmp_path, "other")[1]
    wrong = tmp_path / "wrong.pem"
    wrong.write_text("not a certificate", encoding="utf-8")
    for changes, said in (
        ({"ca": tmp_path / "none.pem"}, r"none.pem: there is no such file; correct ca in the rig file"),
        ({"ca": wrong}, r"wrong.pem: is no certificate in PEM form"),
        ({"key": other}, r"harness.pem and .*other.key are no certificate and its key"),
    ):
        with pytest.raises(ConfigurationError, match=said):
            client_context(ModbusTlsBus(transport="modbus_tls", **(files | changes)))


def test_text_around_a_certificate_and_a_trusted_one_of_openssl_are_read(tmp_path):
    files = make_certificates(tmp_path).harness
    pem = files["certificate"].read_bytes()
    odd = tmp_path / "odd.pem"
    trusted = subprocess.run(
        ["openssl", "x509", "-trustout", "-addtrust", "clientAuth"], input=pem, capture_output=True, check=True
    ).stdout
    assert b"TRUSTED CERTIFICATE" in trusted
    for content in ("subject=O=Müller\n".encode() + pem, trusted):
        odd.write_bytes(content)
        assert validity(odd) == validity(files["certificate"])
        client_context(ModbusTlsBus(transport="modbus_tls", **(files | {"certificate": odd})))


def test_a_certificate_whose_validity_cannot_be_read_is_one_sentence(tmp_path):
    odd = tmp_path / "odd.pem"
    odd.write_bytes(b"-----BEGIN CERTIFICATE-----\nMAA=\n-----END CERTIFICATE-----\n")
    with pytest.raises(ConfigurationError, match=r"odd\.pem: the validity of its first certificate cannot be read"):
        check_valid(odd)


def test_a_key_with_a_password_is_refused_and_not_asked_for(tmp_path):
    files = make_certificates(tmp_path).harness
    locked = tmp_path / "locked.key"
    subprocess.run(
        ["openssl", "pkey", "-in", files["key"], "-aes256", "-passout", "pass:secret", "-out", locked], check=True
    )
    os.chmod(locked, 0o600)
    with pytest.raises(ConfigurationError, match="a key must not have a password"):
        client_context(ModbusTlsBus(transport="modbus_tls", **(files | {"key": locked})))


def test_a_rig_file_names_files_beside_it_and_all_three_of_them(tmp_path):
    text = (PROJECT / "profiles/rigs/virtual.toml").read_text(encoding="utf-8")
    text = text.replace('"thermocouples.dbc"', f'"{PROJECT}/profiles/rigs/thermocouples.dbc"')
    path = tmp_path / "rig.toml"
    secured = 'transport = "modbus_tls"\nca = "ca.pem"\ncertificate = "our.pem"\nkey = "our.key"'
    path.write_text(text.replace('transport = "modbus_tcp"', secured), encoding="utf-8")
    bus = load_rig(path).bus["plc"]
    assert isinstance(bus, ModbusTlsBus)
    assert (bus.ca, bus.key) == (tmp_path / "ca.pem", tmp_path / "our.key")
    path.write_text(text.replace('transport = "modbus_tcp"', secured.rpartition("\n")[0]), encoding="utf-8")
    with pytest.raises(RigFileError, match="key: is missing; add it"):
        load_rig(path)
    assert ModbusTlsBus.model_fields["port"].default == 802


def test_the_virtual_rig_wants_all_three_files_or_none(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "hil", "rig", "--tls-key", __file__],
        capture_output=True,
        text=True,
        cwd=PROJECT,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert "give all three or none" in done.stderr
