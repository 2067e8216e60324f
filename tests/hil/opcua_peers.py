"""A run that is served by OPC UA in a process of its own, certificates for it, and a client of another maker."""

from __future__ import annotations

import contextlib
import datetime
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.hil.streamed_run import StreamedRun

CLIENT_OF_NODE = """
const { OPCUAClient, AttributeIds, DataType } = require("node-opcua-client");
(async () => {
  const client = OPCUAClient.create({ endpointMustExist: false, connectionStrategy: { maxRetry: 2 } });
  await client.connect(process.argv[1]);
  const session = await client.createSession();
  const index = (await session.readNamespaceArray()).indexOf("urn:hil-rig:runs");
  const node = `ns=${index};s=signal/T_tank_C`;
  const value = await session.read({ nodeId: node, attributeId: AttributeIds.Value });
  const path = { startingNode: node, relativePath: { elements: [{
    referenceTypeId: "i=46", isInverse: false, includeSubtypes: true, targetName: { name: "EngineeringUnits" } }] } };
  const found = await session.translateBrowsePath(path);
  const unit = await session.read({ nodeId: found.targets[0].targetId, attributeId: AttributeIds.Value });
  const past = await session.readHistoryValue(node, new Date("2020-01-01"), new Date("2030-01-01"));
  const state = await session.read({ nodeId: `ns=${index};s=run/state`, attributeId: AttributeIds.Value });
  const written = await session.write({ nodeId: node, attributeId: AttributeIds.Value,
    value: { value: { dataType: DataType.Double, value: 1 } } }).then((code) => code.name, (error) => error.message);
  console.log(JSON.stringify({
    value: value.value.value, status: value.statusCode.name, time: value.sourceTimestamp.getTime(),
    unit: unit.value.value.unitId, past: past.historyData.dataValues.map((one) => [
      one.sourceTimestamp.getTime(), one.value ? one.value.value : null, one.statusCode.name]),
    state: state.value.value, written }));
  await session.close();
  await client.disconnect();
})().catch((error) => { console.error(error); process.exit(1); });
"""


@dataclass
class Server:
    """Running `hil stream` with the address that it announced."""

    url: str
    process: subprocess.Popen[str]

    def interrupt(self) -> tuple[int, str]:
        """Press Ctrl-C; return exit code and what was printed since."""
        self.process.send_signal(signal.SIGINT)
        _, printed = self.process.communicate(timeout=30)
        return self.process.returncode, printed


@contextlib.contextmanager
def served(run: StreamedRun, to: str = "opc.tcp://127.0.0.1:0/", *arguments: object) -> Iterator[Server]:
    """Serve a run in a process of its own, and end it with SIGKILL where it still goes on."""
    process = subprocess.Popen(
        [sys.executable, "-W", "error", "-m", "hil", "stream", str(run.path), "--to", to, *map(str, arguments)],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    assert process.stderr is not None
    try:
        line = process.stderr.readline()
        found = re.search(r"is served at (opc\.tcp://\S+);", line)
        assert found, f"the server did not start: {line}{process.stderr.read()}"
        yield Server(found[1], process)
    finally:
        process.kill()
        process.wait(timeout=10)
        process.stderr.close()


def node_modules() -> str | None:
    """Return the folder of globally installed packages of node, where `node-opcua-client` is among them."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        return None
    done = subprocess.run(["npm", "root", "--global"], capture_output=True, text=True, timeout=60, check=False)
    places = (os.environ.get("NODE_PATH", ""), done.stdout.strip())
    return next((place for place in places if place and Path(place, "node-opcua-client").is_dir()), None)


def make_certificate(
    folder: Path, name: str, *, kind: str = "rsa", uri: bool = True, password: bytes | None = None, days: int = 2
) -> tuple[Path, Path]:
    """Make a self-signed certificate with the application URI `urn:test:<name>`, and its key: two files in PEM form."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec, rsa
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    key = ec.generate_private_key(ec.SECP256R1()) if kind == "ec" else rsa.generate_private_key(65537, 2048)
    named = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.datetime.now(datetime.UTC)
    builder = (
        x509.CertificateBuilder()
        .subject_name(named)
        .issuer_name(named)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=3))
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]), False)
    )
    if uri:
        alternatives = [x509.UniformResourceIdentifier(f"urn:test:{name}"), x509.DNSName("localhost")]
        builder = builder.add_extension(x509.SubjectAlternativeName(alternatives), False)
    certificate_file, key_file = folder / f"{name}.pem", folder / f"{name}-key.pem"
    certificate_file.write_bytes(builder.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM))
    locked = serialization.BestAvailableEncryption(password) if password else serialization.NoEncryption()
    key_file.write_bytes(key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, locked))
    return certificate_file, key_file
